//! The Monte Carlo walk: paths through a stack of freshly drawn facets.
//!
//! A path's random numbers are a function of (seed, θi, path number) alone, so that any thread count, SIMD
//! width, resume or shard gives the same exits.

pub mod lanes;
pub mod reference;

/// How a path ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Fate {
    /// Reflected by interface 0 at the first facet and gone.
    Single,
    /// Left the top after meeting interface 0 more than once, without ever entering.
    Rehit,
    /// Entered the stack and came back out of the top.
    Interior,
    /// Passed the last interface.
    Transmitted,
    /// Lost to absorption.
    Absorbed,
    /// Cut by the event cap.
    Truncated,
}

/// Where and how one path ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exit {
    /// Direction of travel on leaving, not normalised; x is the forward direction of the plane of incidence,
    /// z is the distance from the interface (positive on leaving the top). For paths that did not leave the
    /// top it is unspecified.
    pub direction: [f32; 3],
    /// exp(−τ) of the layers crossed: 1 in a lossless stack.
    pub weight: f32,
    /// How it ended.
    pub fate: Fate,
}
