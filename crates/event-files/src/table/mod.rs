//! Columns of numbers, as files of tables and arrays have them, to events.

#[cfg(any(feature = "arrow", feature = "parquet"))]
pub(crate) mod columns;
#[cfg(feature = "tables")]
pub(crate) mod event_numbers;
#[cfg(feature = "tables")]
pub(crate) mod row_events;
#[cfg(feature = "tables")]
pub(crate) mod stated_size;
pub(crate) mod time_unit;
