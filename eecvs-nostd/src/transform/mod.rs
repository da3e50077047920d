//! The transforms: one file each, the trait that they share, and their names.
//!
//! To add a transform, add a file with a type that implements [`Basis`], a variant of [`Transform`], and an oracle
//! in the host's `reference`.

pub mod basis;
pub mod dct;
pub mod dtft;
pub mod dwt;
pub mod haar_scale;
pub mod name;
pub mod phase;
pub mod shape;

pub use basis::Basis;
pub use dct::Dct;
pub use dtft::Dtft;
pub use dwt::Dwt;
pub use name::{GRID_MAX, M_MAX, Rule, Transform};
