//! Pictures for people.

mod plot;

pub use plot::{Curve, time_series_svg};
