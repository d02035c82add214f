//! Pairs of directions side by side. A step of the arithmetic is one loop over the lanes around the scalar calls' own function: the
//! compiler turns it into vector instructions, and the results are the same bits whatever their width.

use crate::Direction;
use crate::numerics::angles::Polar;
use crate::numerics::curve::{Place, STEPS};
use crate::numerics::single::step_of;

/// Pairs handled together.
pub(crate) const LANES: usize = 16;

/// One number a lane, in double and in single precision.
pub(crate) type Lane = [f64; LANES];
pub(crate) type Single = [f32; LANES];

/// `each!(a = lane_a, b = lane_b => [x, y])` is lanes of x and y, made of a and b lane by lane. A macro, not a function that takes a
/// closure: large closures are not inlined, and a call in a loop keeps it from being vectorised.
macro_rules! each {
    ($($x:ident = $lane:expr),+ => $step:expr) => {{
        let mut made = [[0.0; $crate::numerics::lanes::LANES]; _];
        for k in 0..$crate::numerics::lanes::LANES {
            $(let $x = $lane[k];)+
            $crate::numerics::lanes::put(&mut made, k, $step);
        }
        made
    }};
}
pub(crate) use each;

/// Sets one lane of several numbers.
#[inline(always)]
pub(crate) fn put<T, const N: usize>(lanes: &mut [[T; LANES]; N], k: usize, numbers: [T; N]) {
    for (lane, x) in lanes.iter_mut().zip(numbers) {
        lane[k] = x;
    }
}

/// Between which nodes of equal steps each lane is.
pub(crate) struct Steps {
    pub(crate) index: [usize; LANES],
    pub(crate) fraction: Single,
}

impl Steps {
    /// [`step_of`] of every lane.
    #[inline(always)]
    pub(crate) fn of(x: &Single, last: f32) -> Self {
        let mut steps = Self { index: [0; LANES], fraction: [0.0; LANES] };
        for ((index, fraction), &x) in steps.index.iter_mut().zip(&mut steps.fraction).zip(x) {
            (*index, *fraction) = step_of(x, last);
        }
        steps
    }

    /// The places of cosines on the grid of all curves.
    #[inline(always)]
    pub(crate) fn of_cosines(cos: &Lane) -> Self {
        let [u] = each!(cos = cos => [Place::steps_of_cos(cos)]);
        Self::of(&u, (STEPS - 1) as f32)
    }

    #[inline(always)]
    pub(crate) fn place(&self, lane: usize) -> Place {
        Place { index: self.index[lane], fraction: self.fraction[lane] }
    }
}

/// One direction of every pair, above the horizon.
pub(crate) struct Directions {
    pub(crate) w: [Lane; 3],
    pub(crate) theta: Lane,
    pub(crate) sin: Lane,
    /// cos and sin of the azimuth.
    pub(crate) azimuth: [Lane; 2],
    pub(crate) place: Steps,
}

impl Directions {
    /// Of at most [`LANES`] directions that are valid where `valid` says so; elsewhere the pole stands in.
    #[inline(always)]
    pub(crate) fn new(directions: &[Direction], valid: &[bool; LANES]) -> Self {
        let mut w = [[0.0; LANES], [0.0; LANES], [1.0; LANES]];
        for (k, (direction, valid)) in directions.iter().zip(valid).enumerate() {
            let direction = if *valid { *direction } else { [0.0, 0.0, 1.0] };
            for (lane, x) in w.iter_mut().zip(direction) {
                lane[k] = x;
            }
        }
        let [theta, sin, along, across] = each!(x = w[0], y = w[1], z = w[2] => {
            let [Polar { theta, sin, azimuth: (along, across), .. }] = Polar::of([[x, y, z]]);
            [theta, sin, along, across]
        });
        let place = Steps::of_cosines(&w[2]);
        Self { w, theta, sin, azimuth: [along, across], place }
    }

    #[inline(always)]
    pub(crate) fn cos(&self) -> &Lane {
        &self.w[2]
    }

    #[inline(always)]
    pub(crate) fn direction(&self, lane: usize) -> Direction {
        self.w.each_ref().map(|w| w[lane])
    }
}
