//! How the phase of a stack's response advances with the wavenumber.
//!
//! q₀B + C is an entire function of the wavenumber where indices do not depend on it, and its zeros are the poles of r and t: the
//! resonances, all on one side of the real axis if nothing amplifies. So its phase only falls, by π at every resonance however narrow,
//! and two samples between which it has fallen by less have no whole resonance between them (H. M. Nussenzveig, *Causality and
//! Dispersion Relations*, ch. 3). It is known without an unknown multiple of 2π, because it is followed through the layers: in a layer the
//! wave qB + C that goes up turns by Re δ, and from one medium to the next by less than π.

use num_complex::Complex64;

use crate::wave::{
    Admittance, InPlaneWave, Incidence, Layer, LayerMatrix, Multilayer, Polarisation, WaveError, sqrt_upper,
};

impl Multilayer {
    /// arg(q₀B + C) for s and p, continuous in the wavenumber, at an angle of incidence in radians.
    pub(crate) fn phases(&self, wavelength: f64, theta: f64) -> Result<[f64; 2], WaveError> {
        let wave = InPlaneWave::new(self.ambient, Incidence::Angle(theta))?;
        let s = self.phase(&wave, wavelength, Polarisation::S);
        // At normal incidence the two are one.
        Ok([s, if theta == 0.0 { s } else { self.phase(&wave, wavelength, Polarisation::P) }])
    }

    fn phase(&self, wave: &InPlaneWave, wavelength: f64, polarisation: Polarisation) -> f64 {
        let mut medium = wave.admittance(self.substrate, polarisation);
        let mut vector = Admittance::outgoing(self.substrate, medium);
        let mut phase = 0.0;
        for run in self.runs.iter().rev() {
            let crossing = |layer: &Layer| Crossing::new(wave, *layer, wavelength, polarisation);
            let unit: Vec<Crossing> = run.unit.iter().map(crossing).collect();
            for _ in 0..run.repeat {
                for crossing in unit.iter().rev() {
                    phase += turn(&vector, medium, crossing.admittance) - crossing.turn;
                    medium = crossing.admittance;
                    vector = vector.through(crossing.layer, &crossing.matrix);
                }
            }
        }
        phase + turn(&vector, medium, wave.admittance(self.ambient, polarisation))
    }
}

struct Crossing {
    layer: Layer,
    matrix: LayerMatrix,
    admittance: Complex64,
    /// Re δ of the wave that goes down.
    turn: f64,
}

impl Crossing {
    fn new(wave: &InPlaneWave, layer: Layer, wavelength: f64, polarisation: Polarisation) -> Self {
        let matrix = LayerMatrix::new(wave, layer, wavelength, polarisation);
        let kz2 = wave.kz2(layer.index);
        let turn = matrix.delta.value().re;
        let is_backward = kz2.re > 0.0 && sqrt_upper(kz2).re < 0.0;
        Self {
            layer,
            matrix,
            admittance: wave.admittance(layer.index, polarisation),
            turn: if is_backward { -turn } else { turn },
        }
    }
}

/// arg (q′B + C)/(qB + C).
fn turn(vector: &Admittance, from: Complex64, to: Complex64) -> f64 {
    ((to * vector.b + vector.c) * (from * vector.b + vector.c).conj()).arg()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wave::Run;

    /// A plate between mirrors of 1 − 1e-13: from one resonance to the next, half a fringe on either side, the phase falls by π.
    #[test]
    fn a_resonance_between_two_samples_shows_as_half_a_turn() {
        let (high, low) = (Complex64::from(2.3), Complex64::from(1.46));
        let quarter = |n: Complex64| Layer { index: n, thickness: 550e-9 / 4.0 / n.re };
        let mirror: Vec<Layer> = (0..60).map(|i| quarter(if i % 2 == 0 { high } else { low })).collect();
        let spacer = Layer { thickness: 2.0 * quarter(low).thickness, ..quarter(low) };
        let unit = mirror.iter().copied().chain([spacer]).chain(mirror.iter().rev().copied()).collect();
        let filter =
            Multilayer { ambient: 1.0.into(), runs: vec![Run { unit, repeat: 1 }], substrate: 1.0.into() };
        let phases = |nm: f64| filter.phases(nm * 1e-9, 0.0).unwrap();
        // Nothing at 549 and 551 nm tells of the line between them.
        for nm in [549.0, 551.0] {
            let response = filter.solve(nm * 1e-9, Incidence::Angle(0.0), Polarisation::S).unwrap();
            assert!(response.transmittance < 1e-10, "{response:?}");
        }
        for (before, after) in phases(551.0).into_iter().zip(phases(549.0)) {
            assert!((before - after - std::f64::consts::PI).abs() < 0.1, "{before} {after}");
        }
        for (before, after) in phases(553.0).into_iter().zip(phases(551.0)) {
            assert!((before - after).abs() < 0.1, "{before} {after}");
        }
    }

    /// Continuous and falling, also where light is totally reflected on its way or absorbed.
    #[test]
    fn the_phase_only_falls() {
        let layer = |n, k, nm: f64| Layer { index: Complex64::new(n, k), thickness: nm * 1e-9 };
        let unit = vec![
            layer(1.0, 0.0, 300.0),
            layer(2.4, 1e-4, 4000.0),
            layer(1.1, 0.0, 200.0),
            layer(1.5, 0.02, 900.0),
        ];
        for (ambient, theta) in [(1.0, 0.0), (1.0, 1.2), (1.7, 0.9)] {
            let runs = vec![Run { unit: unit.clone(), repeat: 3 }];
            let film =
                Multilayer { ambient: Complex64::from(ambient), runs, substrate: Complex64::new(0.2, 3.0) };
            let mut before = film.phases(700e-9, theta).unwrap();
            let whole = before;
            for i in 1..=20_000 {
                let wavelength = 1.0 / (1.0 / 700e-9 + f64::from(i) * 50.0);
                let phases = film.phases(wavelength, theta).unwrap();
                for (before, now) in before.iter().zip(phases) {
                    let fall = before - now;
                    assert!((-1e-6..1.0).contains(&fall), "{ambient} {theta} {i}: {fall}");
                }
                before = phases;
            }
            assert!(whole.iter().zip(before).all(|(first, last)| first - last > 60.0));
        }
    }
}
