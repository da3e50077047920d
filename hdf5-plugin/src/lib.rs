//! The filter of `eecvs-hdf5` as HDF5's library calls it: `H5Z_class2_t`, and the two functions by which the library finds
//! it in the shared libraries of the folder that `HDF5_PLUGIN_PATH` names.
//!
//! The filter's number is [`eecvs_hdf5::NUMBER`]; its values (`cd_values`) are those of [`Layout::from_values`]. It calls
//! no function of HDF5's library, so that it works with every build of that, also with the one in h5py's wheels:
//!
//! ```text
//! def eecvs(dtype, rows=1 << 18, effort=0):
//!     fields = [dtype.fields[name] for name in "txyp"]
//!     values = [number for kind, offset in fields for number in (offset, kind.itemsize)]
//!     return dict(chunks=(rows,), compression=494, compression_opts=(dtype.itemsize, *values, effort, rows))
//!
//! file.create_dataset("CD/events", data=events, **eecvs(events.dtype))
//! ```
//!
//! Every chunk is packed by itself. Rows that are not events, or not in order of time, are stored as they are: the filter
//! refuses no chunk for its content. If it fails, for want of memory or as its values are wrong, HDF5 stores the chunk without it where the filter is optional
//! (`H5Z_FLAG_OPTIONAL`, which h5py sets).

// The functions that a C library calls. Each argument stands beside its block.
#![allow(unsafe_code)]

use std::ffi::{c_char, c_int, c_uint, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::{ptr, slice};

use eecvs_hdf5::{Error, Layout, NUMBER, pack, unpack};

/// Version of `H5Z_class2_t`, `H5Z_CLASS_T_VERS`.
const CLASS_VERSION: c_int = 1;
/// `H5PL_TYPE_FILTER`.
const TYPE_FILTER: c_int = 0;
/// `H5Z_FLAG_REVERSE`: the chunk is read.
const READING: c_uint = 0x0100;

/// Largest chunk of HDF5, in bytes.
const CHUNK_BYTES_MAX: usize = u32::MAX as usize;

type Filter = unsafe extern "C" fn(
    flags: c_uint,
    values: usize,
    value: *const c_uint,
    bytes: usize,
    room: *mut usize,
    chunk: *mut *mut c_void,
) -> usize;

/// `H5Z_class2_t`.
#[repr(C)]
struct Class {
    version: c_int,
    number: c_int,
    encoder_present: c_uint,
    decoder_present: c_uint,
    name: *const c_char,
    can_apply: *const c_void,
    set_local: *const c_void,
    filter: Filter,
}

// SAFETY: nothing changes it; `name` is a constant, and the other pointers are null.
unsafe impl Sync for Class {}

static CLASS: Class = Class {
    version: CLASS_VERSION,
    number: NUMBER as c_int,
    encoder_present: 1,
    decoder_present: 1,
    name: c"EECVS: events, exact and in order".as_ptr(),
    can_apply: ptr::null(),
    set_local: ptr::null(),
    filter,
};

/// Returns the kind of plugin that this library is: a filter.
// SAFETY: the name is HDF5's for this purpose alone.
#[unsafe(no_mangle)]
pub extern "C" fn H5PLget_plugin_type() -> c_int {
    TYPE_FILTER
}

/// Returns the filter's `H5Z_class2_t`.
// SAFETY: the name is HDF5's for this purpose alone.
#[unsafe(no_mangle)]
pub extern "C" fn H5PLget_plugin_info() -> *const c_void {
    ptr::from_ref(&CLASS).cast()
}

/// Packs or unpacks the `bytes` bytes of `*chunk`, puts the outcome in its place, and returns its size in bytes, or 0 if
/// it fails, when nothing is changed.
///
/// # Safety
/// As HDF5 calls a filter: `value` points to `values` numbers, or is null if there are none; `*chunk` to `*room` bytes from
/// the C library's `malloc`, of which the first `bytes` are set. No other thread uses them meanwhile.
unsafe extern "C" fn filter(
    flags: c_uint,
    values: usize,
    value: *const c_uint,
    bytes: usize,
    room: *mut usize,
    chunk: *mut *mut c_void,
) -> usize {
    if room.is_null() || chunk.is_null() {
        return 0;
    }
    // SAFETY: as the caller promises, and a null pointer is not used.
    let (values, content) = unsafe {
        let content: *const u8 = (*chunk).cast();
        if content.is_null() || bytes > *room || (value.is_null() && values > 0) {
            return 0;
        }
        let values = if values == 0 {
            &[][..]
        } else {
            slice::from_raw_parts(value, values)
        };
        (values, slice::from_raw_parts(content, bytes))
    };
    // A panic must not pass into C; there is none that is known.
    let outcome = catch_unwind(AssertUnwindSafe(|| run(flags, values, content)));
    let Ok(Ok(outcome)) = outcome else {
        return 0;
    };
    // An empty chunk would mean a failure; HDF5 has none.
    if outcome.is_empty() {
        return 0;
    }
    // SAFETY: `malloc` gives as many bytes as the outcome has, or null; the old ones are the C library's, as the caller
    // promises, and nothing refers to them any more.
    unsafe {
        let memory = libc::malloc(outcome.len());
        if memory.is_null() {
            return 0;
        }
        ptr::copy_nonoverlapping(outcome.as_ptr(), memory.cast(), outcome.len());
        libc::free(*chunk);
        *chunk = memory;
        *room = outcome.len();
    }
    outcome.len()
}

/// Memory of the codec for a row and for all of them, in bytes, with room to spare.
const ROW_MEMORY_BYTES: usize = 64;
const MEMORY_BYTES: usize = 64 << 20;

fn run(flags: c_uint, values: &[c_uint], content: &[u8]) -> Result<Vec<u8>, Error> {
    let layout = Layout::from_values(values)?;
    let is_reading = flags & READING != 0;
    let rows = match layout.chunk_bytes() {
        Some(bytes) => bytes / layout.row_bytes(),
        // Packed, a row takes a byte or more, but for equal ones.
        None if is_reading => content.len(),
        None => content.len() / layout.row_bytes(),
    };
    // Where the codec itself finds no memory, the process ends: that there is some is looked at before.
    let needed = rows.saturating_mul(ROW_MEMORY_BYTES + layout.row_bytes());
    let mut probe: Vec<u8> = Vec::new();
    let probed = probe.try_reserve_exact(needed.saturating_add(MEMORY_BYTES));
    probed.map_err(|_| Error::TooLarge)?;
    drop(probe);
    if is_reading {
        unpack(content, &layout, CHUNK_BYTES_MAX)
    } else {
        pack(content, &layout)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Prophesee's compound: x, y, p (i16), two bytes of padding, t.
    const PROPHESEE: [u32; 9] = [16, 8, 8, 0, 2, 2, 2, 4, 2];

    fn rows() -> Vec<u8> {
        let row = |i: u16| {
            let place = [i.wrapping_mul(77) % 640, i.wrapping_mul(31) % 480, i & 1, 0];
            let place = place.into_iter().flat_map(u16::to_le_bytes);
            place.chain((3 * u64::from(i)).to_le_bytes())
        };
        (0..5_000).flat_map(row).collect()
    }

    /// Calls the filter as HDF5's library does.
    fn call(flags: c_uint, values: &[u32], content: &[u8]) -> Option<Vec<u8>> {
        // SAFETY: the memory is `malloc`'s, of this size, and freed below.
        unsafe {
            let mut room = content.len().max(1);
            let mut chunk = libc::malloc(room);
            assert!(!chunk.is_null());
            chunk
                .cast::<u8>()
                .copy_from(content.as_ptr(), content.len());
            let bytes = filter(
                flags,
                values.len(),
                values.as_ptr(),
                content.len(),
                &raw mut room,
                &raw mut chunk,
            );
            assert!(bytes <= room);
            let out = slice::from_raw_parts(chunk.cast::<u8>(), bytes).to_vec();
            libc::free(chunk);
            (bytes > 0).then_some(out)
        }
    }

    #[test]
    fn the_filter_packs_and_unpacks_in_place() {
        let rows = rows();
        let packed = call(0, &PROPHESEE, &rows).unwrap();
        assert!(packed.len() * 4 < rows.len());
        assert_eq!(call(0x100, &PROPHESEE, &packed), Some(rows.clone()));
        assert_eq!(call(0, &[], &rows), None);
        assert_eq!(call(0, &PROPHESEE[..5], &rows), None);
        assert_eq!(call(0, &PROPHESEE, &rows[..17]), None);
        assert_eq!(call(0x100, &PROPHESEE, &rows), None);
        assert_eq!(call(0x100, &PROPHESEE, &[]), None);
    }
}
