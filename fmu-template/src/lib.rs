//! fmu
