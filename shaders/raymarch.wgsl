// Draw the zero level set of a field exactly: a hit is a root of the trilinear field.

#import samples
#import ray
#import one_grid
#import picture
