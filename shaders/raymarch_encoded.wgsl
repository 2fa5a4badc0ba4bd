// Draw the zero level set of a field that is stored in 16 or 8 bits: what the stored numbers stand for, exactly.

#import samples_encoded
#import ray
#import one_grid
#import picture
