//! Arrow's C data interface: structures by which libraries in one process lend each other columns.
//!
//! The layout is that of <https://arrow.apache.org/docs/format/CDataInterface.html>, the capsules those of
//! <https://arrow.apache.org/docs/format/CDataInterface/PyCapsuleInterface.html>. Whoever takes a structure sets the
//! capsule's `release` to null and calls it himself; otherwise the capsule's destructor does.
#![allow(unsafe_code)]

use std::ffi::{CStr, c_char, c_void};
use std::ptr;

use pyo3::prelude::*;
use pyo3::types::PyCapsule;

/// `struct ArrowSchema`.
#[repr(C)]
struct Schema {
    format: *const c_char,
    name: *const c_char,
    metadata: *const c_char,
    flags: i64,
    n_children: i64,
    children: *mut *mut Schema,
    dictionary: *mut Schema,
    release: Option<unsafe extern "C" fn(*mut Schema)>,
    private_data: *mut c_void,
}

/// `struct ArrowArray`.
#[repr(C)]
struct Array {
    length: i64,
    null_count: i64,
    offset: i64,
    n_buffers: i64,
    n_children: i64,
    buffers: *mut *const c_void,
    children: *mut *mut Array,
    dictionary: *mut Array,
    release: Option<unsafe extern "C" fn(*mut Array)>,
    private_data: *mut c_void,
}

// SAFETY: what the pointers lead to is reached through the structure alone, by one thread at a time, as the interface
// asks of its users.
unsafe impl Send for Schema {}
// SAFETY: as above.
unsafe impl Send for Array {}

/// Names and formats of the columns: signed 64 bits, unsigned 16 bits, bits.
const COLUMNS: [(&CStr, &CStr); 4] = [(c"t", c"l"), (c"x", c"S"), (c"y", c"S"), (c"p", c"b")];

/// What a schema's `private_data` owns.
struct SchemaOwned {
    children: Box<[*mut Schema]>,
}

unsafe extern "C" fn release_schema(schema: *mut Schema) {
    // SAFETY: the interface calls this once, with a structure of this module, whose `private_data` is null or a box of
    // `SchemaOwned` with children of boxes. A child that was moved out has no `release` any more.
    unsafe {
        let owned = (*schema).private_data.cast::<SchemaOwned>();
        if !owned.is_null() {
            for child in Box::from_raw(owned).children {
                if let Some(release) = (*child).release {
                    release(child);
                }
                drop(Box::from_raw(child));
            }
        }
        (*schema).release = None;
        (*schema).private_data = ptr::null_mut();
    }
}

fn column_schema(name: &'static CStr, format: &'static CStr) -> Schema {
    Schema {
        format: format.as_ptr(),
        name: name.as_ptr(),
        metadata: ptr::null(),
        flags: 0,
        n_children: 0,
        children: ptr::null_mut(),
        dictionary: ptr::null_mut(),
        release: Some(release_schema),
        private_data: ptr::null_mut(),
    }
}

/// Returns the capsule of the columns' type.
///
/// # Errors
/// Those of Python.
pub fn schema(py: Python<'_>) -> PyResult<Bound<'_, PyCapsule>> {
    let children =
        COLUMNS.map(|(name, format)| Box::into_raw(Box::new(column_schema(name, format))));
    let mut owned = Box::new(SchemaOwned {
        children: children.into(),
    });
    let schema = Schema {
        n_children: COLUMNS.len() as i64,
        children: owned.children.as_mut_ptr(),
        private_data: Box::into_raw(owned).cast(),
        ..column_schema(c"", c"+s")
    };
    PyCapsule::new_with_value_and_destructor(py, schema, c"arrow_schema", |mut schema, _| {
        if let Some(release) = schema.release {
            // SAFETY: nobody has taken the structure, so that this is its only release.
            unsafe { release(&raw mut schema) };
        }
    })
}

/// What an array's `private_data` owns.
struct ArrayOwned {
    buffers: Box<[*const c_void]>,
    children: Box<[*mut Array]>,
    /// The array of NumPy whose memory a buffer is.
    _array: Option<Py<PyAny>>,
    /// The memory of the bits.
    _bits: Option<Vec<u8>>,
}

unsafe extern "C" fn release_array(array: *mut Array) {
    // SAFETY: the interface calls this once, with a structure of this module, whose `private_data` is a box of `ArrayOwned`
    // with children of boxes. A child that was moved out has no `release` any more. An array of NumPy is let go here, or,
    // in a thread without the interpreter, when it runs next.
    unsafe {
        let owned = (*array).private_data.cast::<ArrayOwned>();
        if !owned.is_null() {
            let owned = Box::from_raw(owned);
            for child in &owned.children {
                if let Some(release) = (**child).release {
                    release(*child);
                }
                drop(Box::from_raw(*child));
            }
        }
        (*array).release = None;
        (*array).private_data = ptr::null_mut();
    }
}

fn array_of(length: usize, owned: ArrayOwned) -> Array {
    let mut owned = Box::new(owned);
    Array {
        length: length as i64,
        null_count: 0,
        offset: 0,
        n_buffers: owned.buffers.len() as i64,
        n_children: owned.children.len() as i64,
        buffers: owned.buffers.as_mut_ptr(),
        children: if owned.children.is_empty() {
            ptr::null_mut()
        } else {
            owned.children.as_mut_ptr()
        },
        dictionary: ptr::null_mut(),
        release: Some(release_array),
        private_data: Box::into_raw(owned).cast(),
    }
}

fn column_array(
    length: usize,
    values: *const c_void,
    array: Option<Py<PyAny>>,
    bits: Option<Vec<u8>>,
) -> *mut Array {
    let owned = ArrayOwned {
        // No value is missing.
        buffers: [ptr::null(), values].into(),
        children: Box::default(),
        _array: array,
        _bits: bits,
    };
    Box::into_raw(Box::new(array_of(length, owned)))
}

/// Returns the capsule of `length` events: arrays of NumPy with the addresses of their values, and the bits of p.
///
/// # Errors
/// Those of Python.
pub fn array(
    py: Python<'_>,
    length: usize,
    columns: [(Py<PyAny>, *const c_void); 3],
    bits: Vec<u8>,
) -> PyResult<Bound<'_, PyCapsule>> {
    let mut children: Vec<*mut Array> = columns
        .into_iter()
        .map(|(array, values)| column_array(length, values, Some(array), None))
        .collect();
    // The memory stays where it is when the vector moves.
    children.push(column_array(length, bits.as_ptr().cast(), None, Some(bits)));
    let owned = ArrayOwned {
        buffers: [ptr::null()].into(),
        children: children.into(),
        _array: None,
        _bits: None,
    };
    PyCapsule::new_with_value_and_destructor(
        py,
        array_of(length, owned),
        c"arrow_array",
        |mut array, _| {
            if let Some(release) = array.release {
                // SAFETY: nobody has taken the structure, so that this is its only release.
                unsafe { release(&raw mut array) };
            }
        },
    )
}
