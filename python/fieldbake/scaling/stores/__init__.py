"""Fields in Zarr stores: their layout, the bake in shards, and samples."""
