// Draw the zero level set of a field that the texture hardware interpolates: faster on real hardware, not exact.

#import ray_filtered
#import one_grid
#import picture
