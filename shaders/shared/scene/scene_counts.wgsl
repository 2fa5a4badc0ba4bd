// Counts and sizes of a light pass, kept on the device. The constants are those of src/gpu/constants.rs: words of
// `counts`, stages, and tiles of pixels.
