//! The sync math: the relation of two clocks from two rigidly attached gyroscopes.
pub mod spline;
