// Draws the zero level set of a field that is stored in 16 or 8 bits. A hit is an exact root of the decoded trilinear
// field.

#import samples_encoded
#import ray
#import one_grid
#import picture
