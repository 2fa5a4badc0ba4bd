// Draw the zero level set of a sparse field from its bricks, whatever they are stored in.

#import samples_encoded
#import ray_sparse
#import one_grid
#import picture
