//! Proptest generators shared by the integration tests and the fuzz targets.
