// Draws the zero level set of a sparse field from its bricks, in any encoding.

#import samples_encoded
#import ray_sparse
#import one_grid
#import picture
