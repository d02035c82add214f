//! The lobes of many pairs at once.

use super::{Between, DENSITIES, Incidence, Lobes, SpanCurves, Values};
use super::{
    azimuth_of, concentration_of_sine, densities_of_plane, fraction_of_span, guide_step, restore, restored,
    scale_of_space,
};
use crate::lobes::azimuth::{self, Forward, NARROW, narrow_decay};
use crate::numerics::angles::{self, INVERSE_TAU, Polar};
use crate::numerics::lanes::{Directions, LANES, Lane, Single, Steps, each, put};
use crate::numerics::warp::{Cell, Warp};

/// The lobes at the incidences of every lane.
pub(crate) struct Incidences {
    pub(crate) between: [Between; LANES],
    along: [SpanCurves; LANES],
    /// Of the columns' axis: centre, and gains on either side.
    centre: Lane,
    gains: [Single; 2],
    /// As in [`super::Incidence`].
    pub(crate) azimuth: Single,
}

/// The lobes at one pair of polar angles, for any azimuth.
pub(crate) struct Ring {
    at: Incidence,
    /// What takes the values over to the way there.
    taken_over: f64,
    exit: RingExit,
}

/// What is read at an exit.
enum RingExit {
    /// Decay tables: ahead and behind, and the concentration of the decay.
    Plane { forward: Values, retro: Values, concentration: f32 },
    /// Space tables: the column.
    Space(Cell),
}

/// Cells around an exit, with dposition/dx there.
struct Cells {
    steps: Steps,
    per_x: Single,
}

impl Cells {
    #[inline(always)]
    fn cell(&self, lane: usize) -> Cell {
        Cell { index: self.steps.index[lane], fraction: self.steps.fraction[lane] }
    }
}

impl Lobes {
    /// [`Self::incidence`] of every lane.
    #[inline(always)]
    pub(crate) fn incidences(&self, at: &Directions) -> Incidences {
        self.incidences_at(&at.theta, &at.sin, at.cos())
    }

    #[inline(always)]
    fn incidences_at(&self, theta: &Lane, sin: &Lane, cos: &Lane) -> Incidences {
        let mut steps = [0; LANES];
        for (step, theta) in steps.iter_mut().zip(theta) {
            *step = guide_step(*theta);
        }
        let none = Between { node: 0, next: 0, fraction: 0.0 };
        let (mut spans, mut between) = ([0; LANES], [none; LANES]);
        let ([mut from, mut inverse], [mut width, mut widening]) = ([[0.0; LANES]; 2], [[0.0; LANES]; 2]);
        for k in 0..LANES {
            spans[k] = self.span_of(theta[k], steps[k]);
            let span = &self.spans[spans[k]];
            (between[k].node, between[k].next) = (span.node, span.next);
            (from[k], inverse[k]) = (span.from, span.inverse);
            (width[k], widening[k]) = (span.width, span.widening);
        }
        let [fraction, width] = each!(theta = theta, from = from, inverse = inverse, width = width, widening = widening => {
            let fraction = fraction_of_span(theta, from, inverse);
            [fraction, width + fraction * widening]
        });
        let mut step = Steps { index: [0; LANES], fraction: [0.0; LANES] };
        for (k, fraction) in fraction.iter().enumerate() {
            (step.index[k], step.fraction[k]) = self.step_of_span(*fraction);
        }
        let mut along = [[0.0; 4]; LANES];
        for k in 0..LANES {
            between[k].fraction = fraction[k];
            along[k] = self.curves_at(spans[k], (step.index[k], step.fraction[k]));
        }
        along.iter_mut().for_each(restore);
        let (mut centre, mut gains, mut moved) = ([0.0; LANES], [[0.0; LANES]; 2], [0.0; LANES]);
        for k in 0..LANES {
            let (columns, by) = self.columns_at(theta[k]);
            let (around, gain) = columns.centre_and_gains();
            (centre[k], moved[k]) = (around, by);
            put(&mut gains, k, gain);
        }
        let [azimuth] = if self.signed() {
            each!(sin = sin, width = width => [concentration_of_sine(sin, width)])
        } else {
            each!(sin = sin, cos = cos, moved = moved => [self.row_width(sin, cos, moved)])
        };
        Incidences { between, along, centre, gains, azimuth }
    }

    /// The lobes at a pair of polar angles; in reciprocal tables values are read at the larger one.
    #[inline(always)]
    pub(crate) fn ring(&self, at: &Incidence, i: &Polar, o: &Polar) -> Ring {
        let turned = self.reciprocal && o.theta > i.theta;
        let (at, exit, taken_over) =
            if turned { (self.incidence(o), i, o.cos / i.cos) } else { (*at, o, 1.0) };
        let exit = if self.signed() {
            let [forward, retro] = at
                .columns
                .positions([exit.theta, -exit.theta])
                .map(|(position, _)| self.read(at.between, 0, Cell::new(position, self.columns)));
            RingExit::Plane { forward, retro, concentration: at.azimuth * exit.sin as f32 }
        } else {
            RingExit::Space(Cell::new(at.columns.position(exit.theta).0, self.columns))
        };
        Ring { at, taken_over, exit }
    }

    /// Values of [`Self::light`] at azimuths around a ring, y2 = sin²(φ/2): interior and rehit.
    #[inline(always)]
    pub(crate) fn values_around(&self, Ring { at, taken_over, exit }: &Ring, y2: &Lane) -> [Lane; 2] {
        let mut found = [[0.0; LANES]; 2];
        match exit {
            RingExit::Plane { forward, retro, concentration } => {
                let [y2] = each!(y2 = y2 => [y2 as f32]);
                let share = decays(&[*concentration; LANES], &y2);
                found = each!(share = share => {
                    restored(&at.along, &angles::between(retro, forward, share)).map(|value| value * taken_over)
                });
            }
            RingExit::Space(column) => {
                let around = self.around(at.azimuth);
                let [row] = each!(y2 = y2 => [around.position(azimuth_of(y2)).0]);
                for (k, row) in row.iter().enumerate() {
                    let read = self.read_rows(at.between, Cell::new(*row, self.rows), *column);
                    put(&mut found, k, restored(&at.along, &read).map(|value| value * taken_over));
                }
            }
        }
        found
    }

    /// Values of [`Self::light`] of every lane: interior and rehit.
    #[inline(always)]
    pub(crate) fn values_of(&self, at: &Incidences, i: &Directions, o: &Directions, y2: &Lane) -> [Lane; 2] {
        if !self.reciprocal {
            return self.lights(at, (&o.theta, &o.sin), y2, true, false).0;
        }
        let turned = Turned::of(i, o);
        let at = self.incidences_at(&turned.theta_i, &turned.sin_i, &turned.cos_i);
        let [interior, rehit] = self.lights(&at, (&turned.theta_o, &turned.sin_o), y2, true, false).0;
        each!(interior = interior, rehit = rehit, taken_over = turned.taken_over => {
            [interior * taken_over, rehit * taken_over]
        })
    }

    /// Densities of [`Self::light`] of every lane.
    #[inline(always)]
    pub(crate) fn densities_of(&self, at: &Incidences, o: &Directions, y2: &Lane) -> [Lane; 2] {
        self.lights(at, (&o.theta, &o.sin), y2, false, true).1
    }

    /// Both.
    #[inline(always)]
    pub(crate) fn lights_of(
        &self,
        at: &Incidences,
        i: &Directions,
        o: &Directions,
        y2: &Lane,
    ) -> ([Lane; 2], [Lane; 2]) {
        if self.reciprocal {
            return (self.values_of(at, i, o, y2), self.densities_of(at, o, y2));
        }
        self.lights(at, (&o.theta, &o.sin), y2, true, true)
    }

    /// Values and densities at exits of these θo and sin θo; zeros where they are not asked for.
    #[inline(always)]
    fn lights(
        &self,
        at: &Incidences,
        exit: (&Lane, &Lane),
        y2: &Lane,
        values: bool,
        densities: bool,
    ) -> ([Lane; 2], [Lane; 2]) {
        if self.signed() {
            self.lights_of_plane(at, exit, y2, values, densities)
        } else {
            self.lights_of_space(at, exit, y2, values, densities)
        }
    }

    #[inline(always)]
    fn lights_of_plane(
        &self,
        at: &Incidences,
        (theta_o, sin_o): (&Lane, &Lane),
        y2: &Lane,
        values: bool,
        densities: bool,
    ) -> ([Lane; 2], [Lane; 2]) {
        let ahead = self.column_cells(at, theta_o, 1.0);
        let behind = self.column_cells(at, theta_o, -1.0);
        let [concentration] = each!(azimuth = at.azimuth, sin_o = sin_o => [azimuth * sin_o as f32]);
        let [y2] = each!(y2 = y2 => [y2 as f32]);
        let share = if values { decays(&concentration, &y2) } else { [0.0; LANES] };
        let [per_ahead, per_back, scale] = if densities {
            each!(x = concentration, y2 = y2, ahead = ahead.per_x, behind = behind.per_x, sin_o = sin_o => {
                [Forward::new(x).pdf(y2) * ahead, INVERSE_TAU as f32 * behind, 1.0 / sin_o as f32]
            })
        } else {
            [[0.0; LANES]; 3]
        };
        let (mut forward, mut retro) = ([[0.0; 4]; LANES], [[0.0; 4]; LANES]);
        for k in 0..LANES {
            forward[k] = self.read(at.between[k], 0, ahead.cell(k));
            retro[k] = self.read(at.between[k], 0, behind.cell(k));
        }
        let mut found = ([[0.0; LANES]; 2], [[0.0; LANES]; 2]);
        if values {
            let mut mixed = [[0.0; 4]; LANES];
            for k in 0..LANES {
                mixed[k] = angles::between(&retro[k], &forward[k], share[k]);
            }
            for (k, mixed) in mixed.iter().enumerate() {
                put(&mut found.0, k, restored(&at.along[k], mixed));
            }
        }
        if densities {
            for k in 0..LANES {
                let of_cells = densities_of_plane(&forward[k], &retro[k], per_ahead[k], per_back[k]);
                put(&mut found.1, k, self.density(at, k, of_cells, scale[k], sin_o[k]));
            }
        }
        found
    }

    #[inline(always)]
    fn lights_of_space(
        &self,
        at: &Incidences,
        (theta_o, sin_o): (&Lane, &Lane),
        y2: &Lane,
        values: bool,
        densities: bool,
    ) -> ([Lane; 2], [Lane; 2]) {
        let columns = self.column_cells(at, theta_o, 1.0);
        let [row, per_phi] = each!(width = at.azimuth, y2 = y2 => {
            let (row, per_phi) = self.around(width).position(azimuth_of(y2));
            [row, per_phi]
        });
        let rows = cells(&row, per_phi, self.rows);
        let [scale] = if densities {
            each!(theta = columns.per_x, phi = rows.per_x, sin_o = sin_o => {
                [scale_of_space(theta, phi, sin_o)]
            })
        } else {
            [[0.0; LANES]]
        };
        let mut read = [[0.0; 4]; LANES];
        for (k, read) in read.iter_mut().enumerate() {
            *read = self.read_rows(at.between[k], rows.cell(k), columns.cell(k));
        }
        let mut found = ([[0.0; LANES]; 2], [[0.0; LANES]; 2]);
        if values {
            for (k, read) in read.iter().enumerate() {
                put(&mut found.0, k, restored(&at.along[k], read));
            }
        }
        if densities {
            for (k, read) in read.iter().enumerate() {
                let of_cells = [read[DENSITIES], read[DENSITIES + 1]];
                put(&mut found.1, k, self.density(at, k, of_cells, scale[k], sin_o[k]));
            }
        }
        found
    }

    #[inline(always)]
    fn density(&self, at: &Incidences, lane: usize, of_cells: [f32; 2], scale: f32, sin_o: f64) -> [f64; 2] {
        self.per_steradian(at.between[lane], &at.along[lane], of_cells, scale, sin_o)
    }

    /// The columns at the incidence of a lane.
    #[inline(always)]
    pub(crate) fn columns_in(&self, at: &Incidences, lane: usize) -> Warp {
        self.some_columns.recentred(at.centre[lane], [at.gains[0][lane], at.gains[1][lane]])
    }

    /// Where exits at `side`·θo are among the columns.
    #[inline(always)]
    fn column_cells(&self, at: &Incidences, theta_o: &Lane, side: f64) -> Cells {
        let (centre, [gain_lo, gain_hi]) = (&at.centre, &at.gains);
        let [position, per_x] = each!(theta_o = theta_o, centre = centre, lo = gain_lo, hi = gain_hi => {
            let (position, per_x) = self.some_columns.recentred(centre, [lo, hi]).position(side * theta_o);
            [position, per_x]
        });
        cells(&position, per_x, self.columns)
    }
}

/// The cells around positions.
#[inline(always)]
fn cells(position: &Single, per_x: Single, cells: usize) -> Cells {
    let mut steps = Steps { index: [0; LANES], fraction: [0.0; LANES] };
    for (k, position) in position.iter().enumerate() {
        let cell = Cell::new(*position, cells);
        (steps.index[k], steps.fraction[k]) = (cell.index, cell.fraction);
    }
    Cells { steps, per_x }
}

/// [`azimuth::decay`] of every lane.
#[inline(always)]
fn decays(concentration: &Single, y2: &Single) -> Single {
    let [mut decays] = each!(x = concentration, y2 = y2 => [narrow_decay(x, y2)]);
    // Seldom.
    if concentration.iter().any(|x| *x <= NARROW) {
        for k in 0..LANES {
            if concentration[k] <= NARROW {
                decays[k] = azimuth::decay(concentration[k], y2[k]);
            }
        }
    }
    decays
}

/// Pairs of a reciprocal table, each turned so that the larger angle is the incidence.
struct Turned {
    theta_i: Lane,
    sin_i: Lane,
    cos_i: Lane,
    theta_o: Lane,
    sin_o: Lane,
    /// What takes the values over to the way there.
    taken_over: Lane,
}

impl Turned {
    #[inline(always)]
    fn of(i: &Directions, o: &Directions) -> Self {
        let [theta_i, theta_o] = each!(i = i.theta, o = o.theta => if o > i { [o, i] } else { [i, o] });
        let [sin_i, sin_o] = each!(theta_i = i.theta, theta_o = o.theta, i = i.sin, o = o.sin => {
            if theta_o > theta_i { [o, i] } else { [i, o] }
        });
        let [cos_i, taken_over] = each!(theta_i = i.theta, theta_o = o.theta, i = i.cos(), o = o.cos() => {
            if theta_o > theta_i { [o, o / i] } else { [i, 1.0] }
        });
        Self { theta_i, sin_i, cos_i, theta_o, sin_o, taken_over }
    }
}
