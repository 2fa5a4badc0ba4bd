"""Files of grids: VTI, NRRD, OpenVDB, NanoVDB and vector fields."""
