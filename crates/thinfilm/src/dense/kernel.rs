//! The two inner loops: layers without loss as real rotations, all others as complex amplitudes.
//!
//! No adaptors and closures round the arithmetic of lanes: those are not sure to be inlined into the function that is compiled for the
//! processor's instruction set, and then every `mul_add` is a call.

use super::lanes::{
    FEW_HALF_TURNS, LANES, Lanes, cos_sin_turns, exp2_neg, shears_of_few_half_turns, shears_of_half_turns,
};
use super::levels::{Level, at_each_level};

/// A layer of a stack, as the loops read it.
#[derive(Clone, Copy, Debug)]
pub(super) struct DenseLayer {
    /// Number of its medium.
    pub(super) medium: usize,
    /// Thickness, metres.
    pub(super) thickness: f64,
    /// Source strength in it (emission only).
    pub(super) source: f64,
}

/// Layers of a stack by kind: a regular stack of many layers has few, whose phases are then computed once a tile.
#[derive(Clone, Debug)]
pub(super) struct Kinds {
    /// One layer of each kind.
    pub(super) layers: Vec<DenseLayer>,
    /// How many layers are of it.
    pub(super) counts: Vec<usize>,
    /// Kind of each layer, from the substrate up.
    pub(super) of_layer: Vec<u32>,
}

/// Kinds whose matrices (640 bytes each) stay in the first-level cache.
const MOST_KINDS: usize = 24;

impl Kinds {
    /// `None` where the layers are of too many kinds to gain anything.
    pub(super) fn of(layers: &[DenseLayer]) -> Option<Self> {
        let mut kinds =
            Self { layers: Vec::new(), counts: Vec::new(), of_layer: Vec::with_capacity(layers.len()) };
        for layer in layers {
            let same = |kind: &DenseLayer| {
                kind.medium == layer.medium && kind.thickness.to_bits() == layer.thickness.to_bits()
            };
            let kind = kinds.layers.iter().position(same).unwrap_or(kinds.layers.len());
            if kind == kinds.layers.len() {
                if kind == MOST_KINDS {
                    return None;
                }
                kinds.layers.push(*layer);
                kinds.counts.push(0);
            }
            kinds.counts[kind] += 1;
            kinds.of_layer.push(kind as u32);
        }
        (layers.len() >= 2 * kinds.layers.len()).then_some(kinds)
    }
}

/// What the lossless loop needs of a medium; ratios to a reference admittance, [s, p].
#[derive(Clone, Copy, Debug)]
pub(super) struct LosslessMedium {
    /// Half turns of phase per metre, k₀ kz/π.
    pub(super) half_turns: Lanes,
    /// The largest of them.
    pub(super) most_half_turns: f64,
    /// q_ref/q.
    pub(super) up: [Lanes; 2],
    /// q/q_ref.
    pub(super) down: [Lanes; 2],
    /// Weight of a layer's stored energy in ∫|E|² (emission only).
    pub(super) mean: [Lanes; 2],
    /// Weight of the standing wave's part at its faces (emission only).
    pub(super) face: [Lanes; 2],
}

/// One angle and `LANES` wavelengths through a lossless stack.
pub(super) struct LosslessTile<'a> {
    pub(super) media: &'a [LosslessMedium],
    /// The medium whose admittance is the reference: its layers need no ratios.
    pub(super) reference: usize,
    /// From the substrate up.
    pub(super) layers: &'a [DenseLayer],
    /// The same by kind, where they are of few.
    pub(super) kinds: Option<&'a Kinds>,
    /// q_ref, [s, p].
    pub(super) q_reference: [Lanes; 2],
    /// q of the ambient (real), [s, p].
    pub(super) q_ambient: [Lanes; 2],
    /// (Re, Im) of q of the substrate, [s, p].
    pub(super) q_substrate: [[Lanes; 2]; 2],
}

/// What comes out of a tile; [s, p].
#[derive(Clone, Copy, Debug)]
pub(super) struct TileResult {
    pub(super) reflectance: [Lanes; 2],
    pub(super) transmittance: [Lanes; 2],
    /// Estimate of the error; NaN where nothing is known.
    pub(super) error: [Lanes; 2],
    /// Σ source·∫|E|² for unit |ψ| incident (emission only).
    pub(super) emission: [Lanes; 2],
}

/// A field is scaled down from here on: a layer cannot make it grow by more than the ratio of two indices
/// squared, so that between two looks it stays far from the end of f64.
const RESCALE_ABOVE: f64 = 1.267_650_600_228_229_4e30; // 2^100

/// What a layer adds to the error that the robust form does not share, measured: a rotation keeps its norm, complex
/// amplitudes drift.
const ROTATION_ROUNDING: f64 = 1.387_778_780_781_445_7e-17; // 2^-56
const AMPLITUDE_ROUNDING: f64 = 5.551_115_123_125_783e-17; // 2^-54

/// Most layers between two looks at the energy.
const BLOCK: usize = 16;

/// The order of layers that are not counted by kind.
const ONE_BY_ONE: [u32; BLOCK] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

#[inline(always)]
fn square([re, im]: [Lanes; 2]) -> Lanes {
    re.fma(re, im * im)
}

/// Layers between two looks at the energy. Few layers are looked at one by one: a cavity of three must not be missed.
const fn look_every(layers: usize) -> usize {
    let layers = layers / 24;
    if layers < 1 {
        1
    } else if layers > BLOCK {
        BLOCK
    } else {
        layers
    }
}

/// What is remembered of the faces passed.
#[derive(Clone, Copy)]
struct Memory {
    /// Power of two taken out so far.
    exponent: Lanes,
    /// Largest energy met, on the scale of the present one.
    most: Lanes,
}

impl Memory {
    #[inline(always)]
    fn of(energy: Lanes) -> Self {
        Self { exponent: Lanes::splat(0.0), most: energy }
    }

    /// Notes the energy at a face; where it has grown, returns the power of two by which the field is to be multiplied.
    #[inline(always)]
    fn look(&mut self, energy: Lanes) -> Option<Lanes> {
        self.most = self.most.max(energy);
        if !energy.any_above(RESCALE_ABOVE) {
            return None;
        }
        let factor = energy.map(|x| f64::from_bits((2046 << 52) - (x.sqrt().to_bits() & (0x7ff << 52))));
        self.most = self.most * factor * factor;
        self.exponent = self.exponent - factor.map(f64::log2);
        Some(factor)
    }

    /// r answers to a layer's phase as the power stored there to the power that comes in: a resonance magnifies the
    /// rounding made inside it.
    #[inline(always)]
    fn magnified_rounding(&self, per_layer: f64, layers: usize, incident: Lanes) -> Lanes {
        // Equal layers round alike, so their errors add up as N, not as √N.
        let rounding = per_layer * layers as f64;
        self.most.scale(rounding) / incident
    }
}

/// The admittance vector (B, −iC/q_ref) splits into two real solutions, each rotated by a layer's phase.
///
/// A rotation is three shears, b += τc, c −= sb, b += τc with τ = tan δ/2 and s = sin δ, and the last of a layer and the first of the
/// next are one. So a layer costs half the operations of its matrix, and its determinant is exactly 1.
#[derive(Clone, Copy)]
struct Rotor {
    b: [Lanes; 2],
    c: [Lanes; 2],
    emission: Lanes,
}

// By value throughout: the state must stay in registers.
impl Rotor {
    #[inline(always)]
    fn on_substrate(tile: &LosslessTile, pol: usize) -> Self {
        let [re, im] = tile.q_substrate[pol];
        let inverse = Lanes::splat(1.0) / tile.q_reference[pol];
        Self {
            b: [Lanes::splat(1.0), Lanes::splat(0.0)],
            c: [im * inverse, -(re * inverse)],
            emission: Lanes::splat(0.0),
        }
    }

    #[inline(always)]
    fn shear_b(self, by: Lanes) -> Self {
        let Self { b, c, .. } = self;
        Self { b: [by.fma(c[0], b[0]), by.fma(c[1], b[1])], ..self }
    }

    #[inline(always)]
    fn shear_c(self, by: Lanes) -> Self {
        let Self { b, c, .. } = self;
        Self { c: [by.fma(b[0], c[0]), by.fma(b[1], c[1])], ..self }
    }

    #[inline(always)]
    fn standing(&self) -> Lanes {
        self.b[0].fma(self.c[0], self.b[1] * self.c[1])
    }

    /// Adds s ∫|E|² of a layer, given its standing wave at the lower face.
    #[inline(always)]
    fn emit(self, layer: &DenseLayer, ratio: Lanes, mean: Lanes, face: Lanes, below: Lanes) -> Self {
        let b2 = self.b[0].fma(self.b[0], self.b[1] * self.b[1]);
        let c2 = self.c[0].fma(self.c[0], self.c[1] * self.c[1]);
        let energy = (ratio * ratio).fma(c2, b2).scale(layer.thickness);
        let integral = mean.fma(energy, face * (self.standing() - below));
        Self { emission: self.emission + integral.scale(layer.source), ..self }
    }

    #[inline(always)]
    fn energy(&self) -> Lanes {
        square(self.b) + square(self.c)
    }

    #[inline(always)]
    fn scaled(self, factor: Lanes) -> Self {
        Self {
            b: [self.b[0] * factor, self.b[1] * factor],
            c: [self.c[0] * factor, self.c[1] * factor],
            emission: self.emission * factor * factor,
        }
    }
}

/// What goes up through a lossless stack; [s, p].
struct LosslessWave {
    rotors: [Rotor; 2],
    memories: [Memory; 2],
}

/// Phases, rotations and ends are compiled apart: the polynomials' coefficients and the state of the waves do not fit into the registers
/// together, and what is spilled then is the state.
pub(super) fn lossless(
    level: Level,
    tile: &LosslessTile,
    emission: bool,
    turns: &mut Vec<Turn>,
) -> TileResult {
    let mut wave = lossless_start(level, tile);
    let look_every = look_every(tile.layers.len());
    match tile.kinds {
        Some(kinds) => {
            turns.resize(kinds.layers.len(), Turn::NONE);
            turns_of(level, tile, &kinds.layers, turns);
            if emission {
                turned_emitting(level, tile, tile.layers, turns, &kinds.of_layer, look_every, &mut wave);
            } else {
                turned(level, turns, &kinds.of_layer, look_every, &mut wave);
            }
        }
        None => {
            turns.resize(BLOCK, Turn::NONE);
            for block in tile.layers.chunks(look_every) {
                turns_of(level, tile, block, turns);
                let order = &ONE_BY_ONE[..block.len()];
                if emission {
                    turned_emitting(level, tile, block, turns, order, look_every, &mut wave);
                } else {
                    turned(level, turns, order, look_every, &mut wave);
                }
            }
        }
    }
    lossless_end(level, tile, &wave)
}

at_each_level! { fn lossless_start(tile: &LosslessTile) -> LosslessWave = LosslessWave::on_substrate }
at_each_level! { fn lossless_end(tile: &LosslessTile, wave: &LosslessWave) -> TileResult = finish_lossless }
at_each_level! {
    /// The shears of layers.
    fn turns_of(tile: &LosslessTile, layers: &[DenseLayer], turns: &mut [Turn]) -> () = Turn::of_each
}
at_each_level! {
    /// Through layers in an order of their turns, with a look at the energy every so many.
    fn turned(turns: &[Turn], order: &[u32], look_every: usize, wave: &mut LosslessWave) -> () = LosslessWave::turn
}
at_each_level! {
    /// As `turned`, through layers with sources.
    fn turned_emitting(
        tile: &LosslessTile, layers: &[DenseLayer], turns: &[Turn], order: &[u32], look_every: usize, wave: &mut LosslessWave
    ) -> () = LosslessWave::turn_emitting
}

impl LosslessWave {
    #[inline(always)]
    fn on_substrate(tile: &LosslessTile) -> Self {
        let (s, p) = (Rotor::on_substrate(tile, 0), Rotor::on_substrate(tile, 1));
        Self { rotors: [s, p], memories: [Memory::of(s.energy()), Memory::of(p.energy())] }
    }

    #[inline(always)]
    fn look(&mut self) {
        for (memory, rotor) in self.memories.iter_mut().zip(&mut self.rotors) {
            if let Some(factor) = memory.look(rotor.energy()) {
                *rotor = rotor.scaled(factor);
            }
        }
    }

    /// The shears between layers are joined.
    #[inline(always)]
    fn turn(turns: &[Turn], order: &[u32], look_every: usize, wave: &mut Self) {
        for block in order.chunks(look_every) {
            let [mut s, mut p] = wave.rotors;
            let mut below = &Turn::NONE;
            for &at in block {
                let turn = &turns[at as usize];
                s = s.shear_b(below.b[0] + turn.b[0]).shear_c(turn.c[0]);
                p = p.shear_b(below.b[1] + turn.b[1]).shear_c(turn.c[1]);
                below = turn;
            }
            wave.rotors = [s.shear_b(below.b[0]), p.shear_b(below.b[1])];
            wave.look();
        }
    }

    #[inline(always)]
    fn turn_emitting(
        tile: &LosslessTile,
        layers: &[DenseLayer],
        turns: &[Turn],
        order: &[u32],
        look_every: usize,
        wave: &mut Self,
    ) {
        for (block, order) in layers.chunks(look_every).zip(order.chunks(look_every)) {
            let [mut s, mut p] = wave.rotors;
            for (layer, &at) in block.iter().zip(order) {
                let turn = &turns[at as usize];
                let below = [s.standing(), p.standing()];
                s = s.shear_b(turn.b[0]).shear_c(turn.c[0]).shear_b(turn.b[0]);
                p = p.shear_b(turn.b[1]).shear_c(turn.c[1]).shear_b(turn.b[1]);
                if layer.source != 0.0 {
                    let medium = &tile.media[layer.medium];
                    s = s.emit(layer, medium.up[0], medium.mean[0], medium.face[0], below[0]);
                    p = p.emit(layer, medium.up[1], medium.mean[1], medium.face[1], below[1]);
                }
            }
            wave.rotors = [s, p];
            wave.look();
        }
    }
}

/// The shears of a layer; [s, p].
#[derive(Clone, Copy)]
pub(super) struct Turn {
    /// τ q_ref/q.
    b: [Lanes; 2],
    /// −sin δ q/q_ref.
    c: [Lanes; 2],
}

impl Turn {
    const NONE: Self = Self { b: [Lanes::splat(0.0); 2], c: [Lanes::splat(0.0); 2] };

    #[inline(always)]
    fn of_each(tile: &LosslessTile, layers: &[DenseLayer], turns: &mut [Self]) {
        for (layer, turn) in layers.iter().zip(turns) {
            *turn = Self::new(tile, layer);
        }
    }

    #[inline(always)]
    fn new(tile: &LosslessTile, layer: &DenseLayer) -> Self {
        let medium = &tile.media[layer.medium];
        let half_turns = medium.half_turns.scale(layer.thickness);
        let (tan, minus_sin) = if medium.most_half_turns * layer.thickness <= FEW_HALF_TURNS {
            shears_of_few_half_turns(half_turns)
        } else {
            shears_of_half_turns(half_turns)
        };
        if layer.medium == tile.reference {
            return Self { b: [tan; 2], c: [minus_sin; 2] };
        }
        Self {
            b: [tan * medium.up[0], tan * medium.up[1]],
            c: [minus_sin * medium.down[0], minus_sin * medium.down[1]],
        }
    }
}

#[inline(always)]
fn finish_lossless(tile: &LosslessTile, wave: &LosslessWave) -> TileResult {
    let LosslessWave { rotors, memories } = wave;
    let nothing = [Lanes::splat(0.0); 2];
    let mut result =
        TileResult { reflectance: nothing, transmittance: nothing, error: nothing, emission: nothing };
    for (pol, rotor) in rotors.iter().enumerate() {
        let (q_0, q_ref) = (tile.q_ambient[pol], tile.q_reference[pol]);
        // q₀B and C, real and imaginary parts; the second solution carries −Re C.
        let (b_re, b_im) = (q_0 * rotor.b[0], q_0 * rotor.b[1]);
        let (c_re, c_im) = (-(q_ref * rotor.c[1]), q_ref * rotor.c[0]);
        let reflected = square([b_re - c_re, b_im - c_im]);
        let incident = square([b_re + c_re, b_im + c_im]);
        // Most fields never grow so far as to be scaled, and a library function costs as much as a layer.
        let scale = memories[pol].exponent.map(|e| if e == 0.0 { 1.0 } else { (-2.0 * e).exp2() });
        let transmitted = (q_0 * tile.q_substrate[pol][0]).scale(4.0) * scale;
        let whole = reflected + transmitted;
        result.reflectance[pol] = reflected / whole;
        result.transmittance[pol] = transmitted / whole;
        // Rounding does not know of flux conservation: what it breaks is the measure of what it did.
        let broken = whole.zip(incident, |a, b| (a / b - 1.0).abs());
        // q_ref(B² + C²/q_ref²) stored against |q₀B + C|²/2q₀ coming in.
        let incoming = incident / (q_0 * q_ref).scale(2.0);
        result.error[pol] =
            broken + memories[pol].magnified_rounding(ROTATION_ROUNDING, tile.layers.len(), incoming);
        result.emission[pol] = rotor.emission / incident * (q_0 * q_0).scale(4.0);
    }
    result
}

/// What the complex loop needs of a medium.
#[derive(Clone, Copy, Debug)]
pub(super) struct ComplexMedium {
    /// Turns of phase per metre there and back, 2 k₀ Re kz/2π.
    pub(super) turns: Lanes,
    /// Binary logarithms of decay per metre there and back, 2 k₀ Im kz/ln 2.
    pub(super) decay: Lanes,
    /// |E|² of a wave by itself for unit |ψ|², and of what two interfere to; [s, p] (emission only).
    pub(super) alone: [Lanes; 2],
    pub(super) together: [Lanes; 2],
}

/// An interface, [s, p]: (q_upper − q_lower)/(q_upper + q_lower), and 1/|τ|, τ = 2 q_upper/(q_upper + q_lower).
#[derive(Clone, Copy, Debug)]
pub(super) struct Interface {
    pub(super) rho: [[Lanes; 2]; 2],
    pub(super) inverse_tau: [Lanes; 2],
}

/// One angle and `LANES` wavelengths through any stack.
pub(super) struct ComplexTile<'a> {
    pub(super) media: &'a [ComplexMedium],
    /// From the substrate up.
    pub(super) layers: &'a [DenseLayer],
    /// The same by kind, where they are of few.
    pub(super) kinds: Option<&'a Kinds>,
    /// For each layer the interface at its lower face; last, the ambient's.
    pub(super) interface_of: &'a [usize],
    pub(super) interfaces: &'a [Interface],
    /// q_0 over the largest |q| of a layer, [s, p].
    pub(super) inverse_contrast: [Lanes; 2],
    /// Re q_sub/Re q_0, [s, p].
    pub(super) flux: [Lanes; 2],
}

/// Downward and upward amplitudes at a face, without the growth that `norm` and the total decay keep.
#[derive(Clone, Copy)]
struct Amplitudes {
    down: [Lanes; 2],
    up: [Lanes; 2],
    /// Π 1/|τ|.
    norm: Lanes,
}

// By value throughout: the state must stay in registers.
impl Amplitudes {
    /// In the substrate.
    const INSIDE: Self = Self {
        down: [Lanes::splat(1.0), Lanes::splat(0.0)],
        up: [Lanes::splat(0.0); 2],
        norm: Lanes::splat(1.0),
    };

    #[inline(always)]
    fn interface(self, rho: &[Lanes; 2], inverse_tau: Lanes) -> Self {
        let [re, im] = *rho;
        let (f, g) = (self.down, self.up);
        Self {
            down: [re.fma(g[0], im.fnma(g[1], f[0])), re.fma(g[1], im.fma(g[0], f[1]))],
            up: [re.fma(f[0], im.fnma(f[1], g[0])), re.fma(f[1], im.fma(f[0], g[1]))],
            norm: self.norm * inverse_tau,
        }
    }

    /// ∫|E|² over a layer from its lower face, where these amplitudes are, on the scale of its upper face.
    #[inline(always)]
    fn stored(&self, path: &Path, alone: Lanes, together: Lanes) -> Lanes {
        let (f, g) = (self.down, self.up);
        let waves = path.shrink.fma(square(g), square(f)) * path.mean;
        let product = [f[0].fma(g[0], f[1] * g[1]), f[0].fnma(g[1], f[1] * g[0])];
        let standing = path.standing[0].fma(product[0], path.standing[1] * product[1]);
        alone.fma(waves, together * standing) * self.norm * self.norm
    }

    #[inline(always)]
    fn propagate(self, re: Lanes, im: Lanes) -> Self {
        let g = self.up;
        Self { up: [im.fnma(g[1], re * g[0]), im.fma(g[0], re * g[1])], ..self }
    }

    /// Folds the norm into the amplitudes, so that energies at different faces can be compared.
    #[inline(always)]
    fn normalised(self) -> Self {
        Self { norm: Lanes::splat(1.0), ..self.scaled(self.norm) }
    }

    #[inline(always)]
    fn scaled(self, factor: Lanes) -> Self {
        let Self { down, up, .. } = self;
        Self { down: [down[0] * factor, down[1] * factor], up: [up[0] * factor, up[1] * factor], ..self }
    }

    #[inline(always)]
    fn energy(&self) -> Lanes {
        square(self.down) + square(self.up)
    }
}

at_each_level! { pub(super) fn complex(tile: &ComplexTile) -> TileResult = through_any_stack }

#[inline(always)]
fn through_any_stack(tile: &ComplexTile) -> TileResult {
    let mut waves = [Amplitudes::INSIDE; 2];
    let mut memories = [Memory::of(Lanes::splat(1.0)); 2];
    let mut total_decay = Lanes::splat(0.0);
    let look_every = look_every(tile.layers.len());
    if let Some(kinds) = tile.kinds {
        let mut passages = Vec::with_capacity(kinds.layers.len());
        for (layer, count) in kinds.layers.iter().zip(&kinds.counts) {
            let (factor, decay) = passage(&tile.media[layer.medium], layer);
            passages.push(factor);
            total_decay = total_decay + decay.scale(*count as f64);
        }
        for (block, interfaces) in kinds.of_layer.chunks(look_every).zip(tile.interface_of.chunks(look_every))
        {
            waves = passed(tile, &passages, block, interfaces, waves);
            waves = look_at_waves(&mut memories, waves);
        }
    } else {
        let mut passages = [[Lanes::splat(0.0); 2]; BLOCK];
        for (block, interfaces) in tile.layers.chunks(look_every).zip(tile.interface_of.chunks(look_every)) {
            total_decay = total_decay + passage_block(tile, block, &mut passages);
            waves = passed(tile, &passages, &ONE_BY_ONE[..block.len()], interfaces, waves);
            waves = look_at_waves(&mut memories, waves);
        }
    }
    finish_complex(tile, waves, memories, total_decay)
}

#[inline(always)]
fn look_at_waves(memories: &mut [Memory; 2], mut waves: [Amplitudes; 2]) -> [Amplitudes; 2] {
    for (memory, wave) in memories.iter_mut().zip(&mut waves) {
        *wave = wave.normalised();
        if let Some(factor) = memory.look(wave.energy()) {
            *wave = wave.scaled(factor);
        }
    }
    waves
}

/// e^(2iδ) of a layer as (Re, Im), and the decay in it that was counted.
#[inline(always)]
fn passage(medium: &ComplexMedium, layer: &DenseLayer) -> ([Lanes; 2], Lanes) {
    let (cos, sin) = cos_sin_turns(medium.turns.scale(layer.thickness));
    let decay = medium.decay.scale(layer.thickness);
    let shrink = exp2_neg(decay);
    ([cos * shrink, sin * shrink], decay)
}

/// Way through a layer of an energy, metres.
struct Path {
    /// Of a wave by itself, on the scale of its stronger end.
    mean: Lanes,
    /// Of twice the real part of f·ḡ, and of its imaginary part.
    standing: [Lanes; 2],
    /// |e^(2iδ)|.
    shrink: Lanes,
}

impl Path {
    /// From e^(2iδ), and the decay in it.
    #[inline(always)]
    fn new(medium: &ComplexMedium, layer: &DenseLayer, [re, im]: [Lanes; 2], decay: Lanes) -> Self {
        // (1 − e^−x)/x: a short series where 1 − e^−x has lost digits.
        const FEW: f64 = 1e-3;
        const SERIES: [f64; 5] = [1.0, -0.5, 1.0 / 6.0, -1.0 / 24.0, 1.0 / 120.0];
        let shrink = exp2_neg(decay);
        let x = decay.scale(std::f64::consts::LN_2);
        let series = x.polynomial(&SERIES);
        let whole = (Lanes::splat(1.0) - shrink) / x;
        let mut mean = series;
        for i in 0..LANES {
            mean.0[i] = if x.0[i] < FEW { series.0[i] } else { whole.0[i] };
        }
        let per_phase = Lanes::splat(2.0) / medium.turns.scale(std::f64::consts::TAU);
        Self {
            mean: mean.scale(layer.thickness),
            standing: [im * per_phase, (shrink - re) * per_phase],
            shrink,
        }
    }
}

at_each_level! {
    /// As `complex`, with sources.
    pub(super) fn complex_emitting(tile: &ComplexTile) -> TileResult = through_any_emitting_stack
}

#[inline(always)]
fn through_any_emitting_stack(tile: &ComplexTile) -> TileResult {
    let mut waves = [Amplitudes::INSIDE; 2];
    let mut memories = [Memory::of(Lanes::splat(1.0)); 2];
    let mut emission = [Lanes::splat(0.0); 2];
    let mut total_decay = Lanes::splat(0.0);
    let look_every = look_every(tile.layers.len());
    for (block, interfaces) in tile.layers.chunks(look_every).zip(tile.interface_of.chunks(look_every)) {
        for (layer, &at) in block.iter().zip(interfaces) {
            let medium = &tile.media[layer.medium];
            let (turn, decay) = passage(medium, layer);
            let path = Path::new(medium, layer, turn, decay);
            total_decay = total_decay + decay;
            for pol in 0..2 {
                let interface = &tile.interfaces[at];
                let wave = waves[pol].interface(&interface.rho[pol], interface.inverse_tau[pol]);
                let stored = wave.stored(&path, medium.alone[pol], medium.together[pol]);
                emission[pol] = emission[pol].fma(path.shrink, stored.scale(layer.source));
                waves[pol] = wave.propagate(turn[0], turn[1]);
            }
        }
        for ((wave, memory), emission) in waves.iter_mut().zip(&mut memories).zip(&mut emission) {
            *wave = wave.normalised();
            if let Some(factor) = memory.look(wave.energy()) {
                *wave = wave.scaled(factor);
                *emission = *emission * factor * factor;
            }
        }
    }
    let mut result = finish_complex(tile, waves, memories, total_decay);
    for (pol, emission) in emission.into_iter().enumerate() {
        result.emission[pol] = emission / result.emission[pol];
    }
    result
}

/// Through layers of known passage, each above an interface.
#[inline(always)]
fn passed(
    tile: &ComplexTile,
    passages: &[[Lanes; 2]],
    order: &[u32],
    interfaces: &[usize],
    [mut s, mut p]: [Amplitudes; 2],
) -> [Amplitudes; 2] {
    for (&passage, &at) in order.iter().zip(interfaces) {
        let [re, im] = passages[passage as usize];
        let interface = &tile.interfaces[at];
        s = s.interface(&interface.rho[0], interface.inverse_tau[0]).propagate(re, im);
        p = p.interface(&interface.rho[1], interface.inverse_tau[1]).propagate(re, im);
    }
    [s, p]
}

/// The passages of a block, in a loop of their own; gives the decay of the block.
#[inline(always)]
fn passage_block(tile: &ComplexTile, block: &[DenseLayer], passages: &mut [[Lanes; 2]; BLOCK]) -> Lanes {
    let mut total = Lanes::splat(0.0);
    for (layer, slot) in block.iter().zip(passages) {
        let decay;
        (*slot, decay) = passage(&tile.media[layer.medium], layer);
        total = total + decay;
    }
    total
}

#[inline(always)]
fn finish_complex(
    tile: &ComplexTile,
    waves: [Amplitudes; 2],
    memories: [Memory; 2],
    total_decay: Lanes,
) -> TileResult {
    let top = &tile.interfaces[tile.interface_of[tile.layers.len()]];
    let nothing = [Lanes::splat(0.0); 2];
    let mut result =
        TileResult { reflectance: nothing, transmittance: nothing, error: nothing, emission: nothing };
    for (pol, (wave, memory)) in waves.into_iter().zip(memories).enumerate() {
        let wave = wave.interface(&top.rho[pol], top.inverse_tau[pol]).normalised();
        let (down, up) = (square(wave.down), square(wave.up));
        result.reflectance[pol] = up / down;
        let power = memory.exponent.zip(total_decay, |e, decay| (-2.0 * e - decay).exp2());
        result.transmittance[pol] = power * tile.flux[pol] / down;
        // Of unit |ψ| in the substrate: what is emitted is divided by it.
        result.emission[pol] = down;
        let incoming = down * tile.inverse_contrast[pol];
        result.error[pol] = memory.magnified_rounding(AMPLITUDE_ROUNDING, tile.layers.len(), incoming);
    }
    result
}
