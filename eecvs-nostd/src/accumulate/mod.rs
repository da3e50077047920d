//! Accumulates c_k = sum_i p_i phi_k(u_i) over a pixel's events, with one kernel per family of atoms and grids.

pub mod any_grid;
pub mod cosine;
pub mod dct16;
pub mod dct8;
pub mod dtft16;
pub(crate) mod haar_bytes;
#[allow(dead_code, reason = "assembly has its own")]
mod of_list;
