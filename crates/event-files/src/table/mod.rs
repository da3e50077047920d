//! Turns the columns of numbers in tables and arrays into events.

#[cfg(any(feature = "arrow", feature = "parquet"))]
pub(crate) mod columns;
#[cfg(feature = "tables")]
pub(crate) mod event_numbers;
#[cfg(feature = "tables")]
pub(crate) mod row_events;
#[cfg(feature = "tables")]
pub(crate) mod stated_size;
pub(crate) mod time_unit;
