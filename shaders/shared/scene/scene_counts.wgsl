// Counts and sizes of a light pass, kept on the device. The constants come from src/gpu/constants.rs: words of
// `counts`, stages, and tiles of pixels.
