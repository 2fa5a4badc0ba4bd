//! All errors that a user's request can cause, one enum per stage.
//!
//! Messages name the argument as the user wrote it, the value, and a remedy. The Python layer maps each stage to its
//! own exception class. No user input causes a panic.

#![expect(missing_docs, reason = "the message of a variant is its documentation")]

use thiserror::Error;

/// A mesh that cannot be used.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum MeshError {
    #[error("faces[{face}] refers to vertex {index}, the mesh has {vertices} vertices (valid: 0 to {})", vertices - 1)]
    IndexOutOfRange { face: usize, index: i64, vertices: usize },
    #[error("vertices[{vertex}] = ({x}, {y}, {z}) is not finite and faces[{face}] uses it; remove or repair it")]
    NotFinite { vertex: usize, face: usize, x: f64, y: f64, z: f64 },
    #[error("the mesh is empty: it has {vertices} vertices and {faces} faces; a surface needs at least one face")]
    Empty { vertices: usize, faces: usize },
    #[error("the mesh has no surface: all {faces} faces are degenerate (two equal corners or zero area)")]
    AllDegenerate { faces: usize },
    #[error(
        "the mesh spans {extent:e} units, outside the range that float32 distances can hold ({min:e} to {max:e}); scale it"
    )]
    Extent { extent: f64, min: f64, max: f64 },
    #[error("vertices: must have one row for each of the {vertices} vertices of the mesh, got {count}")]
    MovedCount { count: usize, vertices: usize },
    #[error("vertices[{vertex}] = ({x}, {y}, {z}) is not finite")]
    MovedNotFinite { vertex: usize, x: f64, y: f64, z: f64 },
    #[error(
        "the mesh is open, so it is no solid that can be swept; close it by fieldbake.solid(mesh), or sweep it as a sheet \
         with sign=\"unsigned\""
    )]
    OpenSweep,
    #[error("the mesh has {count} {what}, the limit is {limit}")]
    TooLarge { what: &'static str, count: usize, limit: usize },
    #[error("points: the cloud is empty; a surface needs at least one point")]
    NoPoints,
    #[error("points: {distinct} distinct points are too few for areas, at least {least} are needed; give areas=")]
    FewPoints { distinct: usize, least: usize },
}

/// An invalid option, named as in the Python interface.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{argument}: {problem}")]
pub struct ArgumentError {
    pub argument: &'static str,
    pub problem: String,
}

impl ArgumentError {
    pub fn new(argument: &'static str, problem: impl Into<String>) -> Self {
        Self { argument, problem: problem.into() }
    }
}

/// Looks up the word `name`, the value of the option `argument`, in `table`.
pub fn choice<T: Copy>(argument: &'static str, name: &str, table: &[(&str, T)]) -> Result<T, ArgumentError> {
    table.iter().find(|(word, _)| *word == name).map(|&(_, value)| value).ok_or_else(|| {
        let words: Vec<String> = table.iter().map(|(word, _)| format!("\"{word}\"")).collect();
        ArgumentError::new(argument, format!("must be one of {}, got {name:?}", words.join(", ")))
    })
}

/// A camera, light, instance or material that cannot be drawn, named as in the Python interface.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{what}: {problem}")]
pub struct SceneError {
    pub what: String,
    pub problem: String,
}

impl SceneError {
    pub fn new(what: impl Into<String>, problem: impl Into<String>) -> Self {
        Self { what: what.into(), problem: problem.into() }
    }
}

/// Fields that do not fit an atlas.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum AtlasError {
    #[error(
        "volumes[{item}]: {} do not fit a page of {page_size} x {page_size} texels; page_size must be at least {needed}",
        voxels(shape)
    )]
    PageTooSmall { item: usize, shape: [u32; 3], page_size: u32, needed: u64 },
    #[error(
        "volumes[{item}]: strips hold equal cubes, here of {side}, got {}; bake with resolution=({side}, {side}, {side}), or use layout=\"shelves\"",
        voxels(shape)
    )]
    NotEqualCubes { item: usize, shape: [u32; 3], side: u32 },
    #[error("volumes[{item}]: the atlas has {limit} pages, more are not supported; use a larger page_size")]
    TooManyPages { item: usize, limit: u32 },
}

/// A file that is damaged or of the wrong kind.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{0}")]
pub struct FormatError(pub String);

fn voxels([nx, ny, nz]: &[u32; 3]) -> String {
    format!("{nx} x {ny} x {nz} voxels")
}

/// A CSG shape that cannot be built, read or drawn.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ShapeError {
    #[error("{argument}: {problem}")]
    Argument { argument: &'static str, problem: String },
    #[error("line {line}, column {column}: {problem}")]
    Syntax { line: usize, column: usize, problem: String },
    #[error(
        "the shape has no bounds because of a {leaf}; intersect it with something finite, or give bounds= to a function that has them"
    )]
    Unbounded { leaf: &'static str },
}

impl From<ArgumentError> for ShapeError {
    fn from(ArgumentError { argument, problem }: ArgumentError) -> Self {
        Self::Argument { argument, problem }
    }
}

impl ShapeError {
    pub fn argument(argument: &'static str, problem: impl Into<String>) -> Self {
        Self::Argument { argument, problem: problem.into() }
    }
}

/// A request that does not fit in memory, refused before it starts.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{what} needs {}, {}; {advice}", bytes(*needed), available.map_or_else(
    || "more than the system grants this process".to_owned(), |n| format!("{} are available", bytes(n))))]
pub struct CapacityError {
    pub what: String,
    pub needed: u64,
    /// Free memory in bytes, if the system reports it.
    pub available: Option<u64>,
    pub advice: String,
}

/// A number of bytes as text, exact and rounded.
fn bytes(count: u64) -> String {
    format!("{count} bytes ({:.1} GiB)", count as f64 / (1u64 << 30) as f64)
}

/// A compute device that is missing or failed.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum DeviceError {
    #[error("device: '{requested}' is not available: {reason}")]
    NotAvailable { requested: String, reason: String },
    #[error("device: '{requested}' is unknown; use \"auto\", \"cpu\", \"gpu\" or a name from fieldbake.devices()")]
    Unknown { requested: String },
    #[error(
        "device: '{device}' was opened before this process was forked, and graphics drivers do not survive a fork; start worker processes with the \"spawn\" method, or use device=\"cpu\" in them"
    )]
    Forked { device: String },
    #[error("{device}: {what} needs {needed} bytes, the device allows {limit}; {advice}")]
    TooLarge { device: String, what: String, needed: u64, limit: u64, advice: &'static str },
    #[error(
        "{device}: out of memory for {what} ({needed} bytes); lower the resolution, bake parts of the box through bounds=, or use device=\"cpu\""
    )]
    OutOfMemory { device: String, what: String, needed: u64 },
    #[error("{device}: the device was lost during {what} ({reason}); the next call opens it again")]
    Lost { device: String, what: String, reason: String },
    #[error("{device}: shader {kernel} was refused: {reason}")]
    Shader { device: String, kernel: String, reason: String },
    #[error("{device}: {what} failed: {reason}")]
    Failed { device: String, what: String, reason: String },
}

/// Any failure of the core.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum Error {
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error(transparent)]
    Atlas(#[from] AtlasError),
    #[error(transparent)]
    Format(#[from] FormatError),
    #[error(transparent)]
    Argument(#[from] ArgumentError),
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Shape(#[from] ShapeError),
    #[error(transparent)]
    Capacity(#[from] CapacityError),
    #[error(transparent)]
    Device(#[from] DeviceError),
    #[error("cancelled")]
    Cancelled,
}

pub type Result<T, E = Error> = std::result::Result<T, E>;
