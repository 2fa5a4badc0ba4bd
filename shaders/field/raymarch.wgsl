// Draws the zero level set of a float32 field. A hit is an exact root of the trilinear field.

#import samples
#import ray
#import one_grid
#import picture
