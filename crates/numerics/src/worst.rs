//! The largest of several errors.

/// Largest of several errors, 0 of none. NaN is larger than any number, where `f64::max` would leave it out.
pub fn worst(errors: impl Iterator<Item = f64>) -> f64 {
    errors.fold(0.0, |worst, error| if error > worst || error.is_nan() { error } else { worst })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_is_the_worst_wherever_it_stands() {
        assert_eq!(worst([0.5, 2.0, 1.0].into_iter()), 2.0);
        assert_eq!(worst(std::iter::empty()), 0.0);
        for errors in [[f64::NAN, 1.0], [1.0, f64::NAN], [f64::NAN, f64::INFINITY]] {
            assert!(worst(errors.into_iter()).is_nan(), "{errors:?}");
        }
    }
}
