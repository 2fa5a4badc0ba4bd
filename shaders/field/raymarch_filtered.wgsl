// Draws the zero level set of a field that the texture hardware interpolates. This is faster on real hardware, and
// approximate.

#import ray_filtered
#import one_grid
#import picture
