"""Libraries of assets and grids beyond memory, in one process, on all cores or on a cluster."""
