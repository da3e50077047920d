//! The transforms: a file each, what all of them do, and their names.
//!
//! A further transform is one new file with a type that implements [`Basis`], one entry of
//! [`Transform`], and one oracle in the host's `reference`.

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
