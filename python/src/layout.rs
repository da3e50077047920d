//! The layouts of events in structured arrays, and arrays made of events.

use event_types::Event;
use event_types::error;
use event_types::stream::{BATCH_EVENTS, Error, EventReader, Result};
use numpy::PyArray1;
use numpy::ndarray::ArrayView1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::memory;

/// A layout; `eecvs._types.DTYPES` has its data type of NumPy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Name in `DTYPES`.
    pub name: &'static str,
    fields: Fields,
}

/// How an event's fields lie in its bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fields {
    /// As in [`Event`]: t, x, y, p at bytes 0, 8, 10, 12 of 16.
    Own,
    /// x, y, t, p without gaps: 13 bytes.
    Tonic,
    /// t, x, y, p without gaps: 13 bytes.
    Faery,
    /// x, y, p of two bytes, t at bytes 0, 2, 4, 8 of 16.
    Metavision,
}

/// All layouts; the first is the default.
pub const LAYOUTS: [Layout; 6] = [
    Layout {
        name: "eecvs",
        fields: Fields::Own,
    },
    Layout {
        name: "tonic",
        fields: Fields::Tonic,
    },
    Layout {
        name: "faery",
        fields: Fields::Faery,
    },
    Layout {
        name: "expelliarmus",
        fields: Fields::Own,
    },
    Layout {
        name: "metavision",
        fields: Fields::Metavision,
    },
    Layout {
        name: "dv",
        fields: Fields::Own,
    },
];

impl Layout {
    /// Returns the layout of this name.
    ///
    /// # Errors
    /// There is none: `ValueError`.
    pub fn of(name: Option<&str>) -> PyResult<Self> {
        let name = name.unwrap_or(LAYOUTS[0].name);
        let found = LAYOUTS.into_iter().find(|layout| layout.name == name);
        found.ok_or_else(|| {
            let names = LAYOUTS.map(|layout| layout.name).join(", ");
            PyValueError::new_err(format!("dtype is {name:?}: it must be one of {names}"))
        })
    }

    /// Returns the data type.
    fn dtype<'py>(self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let dtypes = py.import("eecvs._types")?.getattr("DTYPES")?;
        dtypes.cast_into::<PyDict>()?.as_any().get_item(self.name)
    }
}

/// Events in the memory of an array to be.
pub enum Packed {
    /// In the own layout.
    Own(Vec<Event>),
    /// In any other.
    Bytes(Vec<u8>),
}

impl Packed {
    /// Makes room for about as many events: a guess.
    pub fn guess(&mut self, events: u64) {
        match self {
            Self::Own(own) => {
                if own.is_empty() {
                    *own = memory::of_earlier(events);
                }
                if own.capacity() == 0 {
                    memory::guess(own, events);
                }
            }
            Self::Bytes(bytes) => memory::guess(bytes, events.saturating_mul(16)),
        }
    }

    /// Creates memory without events.
    pub const fn new(layout: Layout) -> Self {
        match layout.fields {
            Fields::Own => Self::Own(Vec::new()),
            _ => Self::Bytes(Vec::new()),
        }
    }
}

/// Reads events into the memory of arrays.
pub struct Packer {
    layout: Layout,
    /// A batch, for layouts other than the own one.
    batch: Vec<Event>,
}

impl Packer {
    pub const fn new(layout: Layout) -> Self {
        Self {
            layout,
            batch: Vec::new(),
        }
    }

    /// Appends what one call of a reader or of a slicer returns; returns what that returned.
    ///
    /// # Errors
    /// Those of the call; the system refuses the memory.
    pub fn add<T>(
        &mut self,
        packed: &mut Packed,
        read: impl FnOnce(&mut Vec<Event>) -> Result<T>,
    ) -> Result<T> {
        match packed {
            Packed::Own(events) => {
                memory::room(events, BATCH_EVENTS).map_err(no_memory)?;
                let before = events.len();
                let read = read(events);
                clear_padding(&mut events[before..]);
                read
            }
            Packed::Bytes(bytes) => {
                self.batch.clear();
                let read = read(&mut self.batch);
                pack(self.layout, &self.batch, bytes)?;
                read
            }
        }
    }

    /// Appends events.
    ///
    /// # Errors
    /// The system refuses the memory.
    pub fn extend(&mut self, packed: &mut Packed, events: &[Event]) -> Result<()> {
        self.add(packed, |all| {
            all.try_reserve(events.len()).map_err(no_memory)?;
            all.extend_from_slice(events);
            Ok(())
        })
    }

    /// Reads a reader to its end. Events before an error are in `packed`.
    ///
    /// # Errors
    /// Those of the reader; the system refuses the memory.
    pub fn read_all(&mut self, packed: &mut Packed, reader: &mut dyn EventReader) -> Result<()> {
        while self.add(packed, |events| reader.read(events))? > 0 {}
        Ok(())
    }
}

pub fn no_memory(_: std::collections::TryReserveError) -> Error {
    error!(
        Refused,
        "the system refuses the memory for these events: read them in slices"
    )
}

/// Sets the bytes of events that belong to no field to 0, so that arrays hold no uninitialised memory.
fn clear_padding(events: &mut [Event]) {
    for event in events {
        let polarity = event.polarity as u8;
        let last = std::ptr::from_mut(event).cast::<u8>().wrapping_add(12);
        // SAFETY: an `Event` has 16 bytes and an alignment of 8, its polarity at byte 12 and no field behind that (which
        // event-types asserts): the word of bytes 12 to 15 is inside of it and aligned, and its first byte in memory is a
        // valid polarity.
        #[allow(unsafe_code)]
        unsafe {
            last.cast::<u32>()
                .write(u32::from_ne_bytes([polarity, 0, 0, 0]));
        }
    }
}

/// Appends events in a layout other than the own one.
fn pack(layout: Layout, events: &[Event], bytes: &mut Vec<u8>) -> Result<()> {
    fn rows<const N: usize>(
        events: &[Event],
        bytes: &mut Vec<u8>,
        row: impl Fn(&Event) -> [u8; N],
    ) -> Result<()> {
        memory::room(bytes, events.len() * N).map_err(no_memory)?;
        let start = bytes.len();
        bytes.resize(start + events.len() * N, 0);
        let (slots, _) = bytes[start..].as_chunks_mut::<N>();
        for (slot, event) in slots.iter_mut().zip(events) {
            *slot = row(event);
        }
        Ok(())
    }
    match layout.fields {
        Fields::Own => Ok(()),
        Fields::Tonic => rows::<13>(events, bytes, |event| {
            let mut row = [0; 13];
            row[..2].copy_from_slice(&event.x.to_le_bytes());
            row[2..4].copy_from_slice(&event.y.to_le_bytes());
            row[4..12].copy_from_slice(&event.t_us.to_le_bytes());
            row[12] = event.polarity as u8;
            row
        }),
        Fields::Faery => rows::<13>(events, bytes, |event| {
            let mut row = [0; 13];
            row[..8].copy_from_slice(&event.t_us.to_le_bytes());
            row[8..10].copy_from_slice(&event.x.to_le_bytes());
            row[10..12].copy_from_slice(&event.y.to_le_bytes());
            row[12] = event.polarity as u8;
            row
        }),
        Fields::Metavision => rows::<16>(events, bytes, |event| {
            let mut row = [0; 16];
            row[..2].copy_from_slice(&event.x.to_le_bytes());
            row[2..4].copy_from_slice(&event.y.to_le_bytes());
            row[4..6].copy_from_slice(&u16::from(event.polarity as u8).to_le_bytes());
            row[8..].copy_from_slice(&event.t_us.to_le_bytes());
            row
        }),
    }
}

/// Returns an array over the memory of `packed`, which is not copied.
///
/// # Errors
/// Those of NumPy.
pub fn array<'py>(py: Python<'py>, layout: Layout, packed: Packed) -> PyResult<Bound<'py, PyAny>> {
    let flat = match packed {
        Packed::Own(mut events) => {
            if !memory::is_kept(events.capacity()) {
                events.shrink_to_fit();
            }
            Memory::array(py, events)?
        }
        Packed::Bytes(mut bytes) => {
            bytes.shrink_to_fit();
            PyArray1::from_vec(py, bytes).into_any()
        }
    };
    flat.call_method1("view", (layout.dtype(py)?,))
}

/// The memory of an array of events.
#[pyclass(frozen)]
struct Memory {
    /// Without events: what Python writes need not be any.
    events: Vec<Event>,
}

impl Memory {
    /// Returns an array of words over the memory of events, whose padding has been set by [`clear_padding`].
    fn array(py: Python<'_>, mut events: Vec<Event>) -> PyResult<Bound<'_, PyAny>> {
        const { assert!(size_of::<Event>() == 2 * size_of::<u64>()) };
        const { assert!(align_of::<Event>() == align_of::<u64>()) };
        let (start, words) = (events.as_mut_ptr().cast::<u64>(), 2 * events.len());
        events.clear();
        let memory = Bound::new(py, Self { events })?;
        // SAFETY: the memory has so many words, all of whose bytes are initialised, the padding of events too. The vector
        // lives as long as the array, whose base it is, and nothing else reads or writes it until then.
        #[allow(unsafe_code)]
        let array = unsafe {
            let words = ArrayView1::from_shape_ptr(words, start);
            PyArray1::borrow_from_array(&words, memory.into_any())
        };
        Ok(array.into_any())
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        memory::keep(std::mem::take(&mut self.events));
    }
}

/// Returns an array of events in a layout.
///
/// # Errors
/// Those of NumPy; `MemoryError` as a `RefusedError`.
pub fn array_of<'py>(
    py: Python<'py>,
    layout: Layout,
    events: &[Event],
) -> PyResult<Bound<'py, PyAny>> {
    let mut packed = Packed::new(layout);
    Packer::new(layout)
        .extend(&mut packed, events)
        .map_err(|error| crate::errors::exception(py, &error, None))?;
    array(py, layout, packed)
}
