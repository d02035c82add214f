//! The two inner loops: layers without loss as real rotations, all others as complex amplitudes.
//!
//! As many lanes of a tile go through all layers together as leave room in the registers for the state of both waves: a tile of AVX-512 in two
//! parts, of AVX2 in four. The phase of a layer is computed where it is used, because on some processors storing vectors costs as much
//! as computing with them.
//!
//! No adaptors and closures round the arithmetic of lanes: those are not sure to be inlined into the function that is compiled for the
//! processor's instruction set, and then every `mul_add` is a call.

use super::lanes::{
    FEW_HALF_TURNS, LANES, LITTLE_DECAY, Lanes, Real, cos_sin_quarter_turns, exp2_neg, exp2_neg_of_little,
    sin_cos_of_few_half_turns, sin_cos_of_half_turns,
};
use super::levels::at_each_level;

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

/// Kinds whose shears (512 bytes each) stay in the first-level cache.
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
pub(super) struct LosslessMedium<T = f64> {
    /// Half turns of phase per metre, k₀ kz/π.
    pub(super) half_turns: Lanes,
    /// The largest of them.
    pub(super) most_half_turns: f64,
    /// q_ref/q.
    pub(super) up: [Lanes<LANES, T>; 2],
    /// q/q_ref.
    pub(super) down: [Lanes<LANES, T>; 2],
    /// Weight of a layer's stored energy in ∫|E|² (emission only).
    pub(super) mean: [Lanes<LANES, T>; 2],
    /// Weight of the standing wave's part at its faces (emission only).
    pub(super) face: [Lanes<LANES, T>; 2],
}

impl LosslessMedium {
    pub(super) fn in_single(&self) -> LosslessMedium<f32> {
        let cast = |[s, p]: &[Lanes; 2]| [s.cast(), p.cast()];
        LosslessMedium {
            half_turns: self.half_turns,
            most_half_turns: self.most_half_turns,
            up: cast(&self.up),
            down: cast(&self.down),
            mean: cast(&self.mean),
            face: cast(&self.face),
        }
    }
}

/// One angle and `LANES` wavelengths through a lossless stack.
pub(super) struct LosslessTile<'a, T = f64> {
    pub(super) media: &'a [LosslessMedium<T>],
    /// The medium whose admittance is the reference: its layers need no ratios.
    pub(super) reference: usize,
    /// From the substrate up.
    pub(super) layers: &'a [DenseLayer],
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

impl TileResult {
    /// Of a tile that no loop takes.
    pub(super) const UNKNOWN: Self = Self {
        reflectance: [Lanes::splat(0.0); 2],
        transmittance: [Lanes::splat(0.0); 2],
        error: [Lanes::splat(f64::NAN); 2],
        emission: [Lanes::splat(0.0); 2],
    };
}

/// What a layer adds to the error that the robust form does not share, measured: complex amplitudes drift.
const AMPLITUDE_ROUNDING: f64 = 5.551_115_123_125_783e-17; // 2^-54

/// Most layers between two looks at the energy.
const BLOCK: usize = 16;

#[inline(always)]
fn square<const W: usize, T: Real>([re, im]: [Lanes<W, T>; 2]) -> Lanes<W, T> {
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
struct Memory<const W: usize, T = f64> {
    /// Power of two taken out so far.
    exponent: Lanes<W, T>,
    /// Largest energy met, on the scale of the present one.
    most: Lanes<W, T>,
}

impl<const W: usize, T: Real> Memory<W, T> {
    #[inline(always)]
    fn of(energy: Lanes<W, T>) -> Self {
        Self { exponent: Lanes::splat(T::ZERO), most: energy }
    }

    /// Notes the energy at a face; where it has grown, returns the power of two by which the field is to be multiplied.
    #[inline(always)]
    fn look(&mut self, energy: Lanes<W, T>) -> Option<Lanes<W, T>> {
        self.most = self.most.max(energy);
        if !energy.any_above(T::RESCALE_ABOVE) {
            return None;
        }
        let factor = energy.map(T::power_that_scales);
        self.most = self.most * factor * factor;
        self.exponent = self.exponent - factor.map(|x| T::of(x.to_f64().log2()));
        Some(factor)
    }
}

impl<const W: usize> Memory<W> {
    /// r answers to a layer's phase as the power stored there to the power that comes in: a resonance magnifies the
    /// rounding made inside it.
    #[inline(always)]
    fn magnified_rounding(&self, per_layer: f64, layers: usize, incident: Lanes<W>) -> Lanes<W> {
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
struct Rotor<const W: usize, T = f64> {
    b: [Lanes<W, T>; 2],
    c: [Lanes<W, T>; 2],
    emission: Lanes<W, T>,
}

// By value throughout: the state must stay in registers.
impl<const W: usize, T: Real> Rotor<W, T> {
    #[inline(always)]
    fn on_substrate(tile: &LosslessTile<T>, first: usize, pol: usize) -> Self {
        let [re, im] = &tile.q_substrate[pol];
        let inverse = Lanes::splat(T::ONE) / tile.q_reference[pol].part(first);
        Self {
            b: [Lanes::splat(T::ONE), Lanes::splat(T::ZERO)],
            c: [im.part(first) * inverse, -(re.part(first) * inverse)],
            emission: Lanes::splat(T::ZERO),
        }
    }

    #[inline(always)]
    fn shear_b(self, by: Lanes<W, T>) -> Self {
        let Self { b, c, .. } = self;
        Self { b: [by.fma(c[0], b[0]), by.fma(c[1], b[1])], ..self }
    }

    #[inline(always)]
    fn shear_c(self, by: Lanes<W, T>) -> Self {
        let Self { b, c, .. } = self;
        Self { c: [by.fma(b[0], c[0]), by.fma(b[1], c[1])], ..self }
    }

    #[inline(always)]
    fn standing(&self) -> Lanes<W, T> {
        self.b[0].fma(self.c[0], self.b[1] * self.c[1])
    }

    /// Adds s ∫|E|² of a layer, given its standing wave at the lower face.
    #[inline(always)]
    fn emit(
        self,
        layer: &DenseLayer,
        medium: &LosslessMedium<T>,
        first: usize,
        pol: usize,
        below: Lanes<W, T>,
    ) -> Self {
        let ratio: Lanes<W, T> = medium.up[pol].part(first);
        let b2 = self.b[0].fma(self.b[0], self.b[1] * self.b[1]);
        let c2 = self.c[0].fma(self.c[0], self.c[1] * self.c[1]);
        let energy = (ratio * ratio).fma(c2, b2).scale(T::of(layer.thickness));
        let face = medium.face[pol].part(first);
        let integral = medium.mean[pol].part(first).fma(energy, face * (self.standing() - below));
        Self { emission: self.emission + integral.scale(T::of(layer.source)), ..self }
    }

    /// The same of a layer of a kind, given what its standing wave gains.
    #[inline(always)]
    fn give_off(self, source: f64, store: &Store, first: usize, pol: usize, gained: Lanes<W, T>) -> Self {
        let (b2, c2) = (square(self.b), square(self.c));
        let of_b = store.b[pol].part::<W, T>(first) * b2;
        let stored = store.face[pol].part(first).fma(gained, store.c[pol].part(first).fma(c2, of_b));
        Self { emission: stored.fma(Lanes::splat(T::of(source)), self.emission), ..self }
    }

    #[inline(always)]
    fn energy(&self) -> Lanes<W, T> {
        square(self.b) + square(self.c)
    }

    #[inline(always)]
    fn scaled(self, factor: Lanes<W, T>) -> Self {
        Self {
            b: [self.b[0] * factor, self.b[1] * factor],
            c: [self.c[0] * factor, self.c[1] * factor],
            emission: self.emission * factor * factor,
        }
    }
}

/// What goes up through a lossless stack; [s, p].
struct LosslessWave<const W: usize, T = f64> {
    rotors: [Rotor<W, T>; 2],
    memories: [Memory<W, T>; 2],
}

at_each_level! {
    /// Through a lossless stack, layer by layer.
    pub(super) fn lossless(tile: &LosslessTile) -> TileResult = through_clear_stack[8, 4, 2]
}
at_each_level! {
    /// The same in single precision.
    pub(super) fn lossless_in_single(tile: &LosslessTile<f32>) -> TileResult = through_clear_stack_in_single[16, 8, 4]
}
at_each_level! {
    /// The same by kind. In AVX-512 one half of a tile does not keep the processor busy.
    pub(super) fn lossless_by_kind(tile: &LosslessTile, kinds: &Kinds, turns: &mut Vec<Turn>) -> TileResult
        = through_clear_kinds[16, 4, 2]
}
at_each_level! {
    /// Through a lossless stack with sources.
    pub(super) fn lossless_emitting(tile: &LosslessTile) -> TileResult = through_emitting_clear_stack[8, 4, 2]
}
at_each_level! {
    /// The same in single precision.
    pub(super) fn lossless_emitting_in_single(tile: &LosslessTile<f32>) -> TileResult = through_emitting_clear_stack_in_single[16, 8, 4]
}
at_each_level! {
    /// The same by kind.
    pub(super) fn lossless_emitting_by_kind(tile: &LosslessTile, kinds: &Kinds, turns: &mut Vec<Turn>, stores: &mut Vec<Store>) -> TileResult
        = through_emitting_clear_kinds[16, 4, 2]
}

#[inline(always)]
fn through_clear_stack<const W: usize>(tile: &LosslessTile) -> TileResult {
    rotate::<W, f64, false>(tile)
}

#[inline(always)]
fn through_clear_stack_in_single<const W: usize>(tile: &LosslessTile<f32>) -> TileResult {
    rotate::<W, f32, false>(tile)
}

#[inline(always)]
fn through_emitting_clear_stack<const W: usize>(tile: &LosslessTile) -> TileResult {
    rotate::<W, f64, true>(tile)
}

#[inline(always)]
fn through_emitting_clear_stack_in_single<const W: usize>(tile: &LosslessTile<f32>) -> TileResult {
    rotate::<W, f32, true>(tile)
}

#[inline(always)]
fn rotate<const W: usize, T: Real, const EMITS: bool>(tile: &LosslessTile<T>) -> TileResult {
    let mut result = TileResult::UNKNOWN;
    for first in (0..LANES).step_by(W) {
        let mut wave = LosslessWave::<W, T>::on_substrate(tile, first);
        wave.turn::<EMITS>(tile, first);
        finish_lossless(tile, first, &wave.in_full(), T::ROTATION_ROUNDING, &mut result);
    }
    result
}

#[inline(always)]
fn through_clear_kinds<const W: usize>(
    tile: &LosslessTile,
    kinds: &Kinds,
    turns: &mut Vec<Turn>,
) -> TileResult {
    let mut result = TileResult::UNKNOWN;
    for first in (0..LANES).step_by(W) {
        let mut wave = LosslessWave::<W>::on_substrate(tile, first);
        turns_of_kinds::<W>(tile, kinds, first, turns);
        wave.turn_by_kind(turns, kinds, first);
        finish_lossless(tile, first, &wave, f64::ROTATION_ROUNDING, &mut result);
    }
    result
}

#[inline(always)]
fn through_emitting_clear_kinds<const W: usize>(
    tile: &LosslessTile,
    kinds: &Kinds,
    turns: &mut Vec<Turn>,
    stores: &mut Vec<Store>,
) -> TileResult {
    let mut result = TileResult::UNKNOWN;
    stores.clear();
    stores.extend(kinds.layers.iter().map(|layer| Store::new(layer, &tile.media[layer.medium])));
    for first in (0..LANES).step_by(W) {
        let mut wave = LosslessWave::<W>::on_substrate(tile, first);
        turns_of_kinds::<W>(tile, kinds, first, turns);
        wave.turn_emitting_by_kind(tile, turns, stores, kinds, first);
        finish_lossless(tile, first, &wave, f64::ROTATION_ROUNDING, &mut result);
    }
    result
}

/// The shears of each kind, as far as they are those of some lanes.
#[inline(always)]
fn turns_of_kinds<const W: usize>(tile: &LosslessTile, kinds: &Kinds, first: usize, turns: &mut Vec<Turn>) {
    turns.resize(kinds.layers.len(), Turn::NONE);
    for (layer, turn) in kinds.layers.iter().zip(turns.iter_mut()) {
        let sines = Sines::<W>::new(tile, layer, first);
        turn.set_part(first, sines.turn(tile, layer.medium, first));
    }
}

/// The shears of layer after layer from the substrate up, computed two layers ahead of their use: what is needed now never waits for what
/// is computed now.
struct Turns<'a, const W: usize, T = f64> {
    tile: &'a LosslessTile<'a, T>,
    first: usize,
    /// Of the next layer.
    turn: Turn<W, T>,
    /// Of the one after it.
    sines: Sines<W, T>,
    /// That one.
    layer: &'a DenseLayer,
    /// The layers above it.
    above: std::slice::Iter<'a, DenseLayer>,
}

impl<'a, const W: usize, T: Real> Turns<'a, W, T> {
    #[inline(always)]
    fn new(
        tile: &'a LosslessTile<T>,
        lowest: &'a DenseLayer,
        above: std::slice::Iter<'a, DenseLayer>,
        first: usize,
    ) -> Self {
        let sines = Sines::new(tile, lowest, first);
        let mut turns = Self { tile, first, turn: Turn::NONE, sines, layer: lowest, above };
        turns.next();
        turns
    }

    #[inline(always)]
    fn next(&mut self) -> Turn<W, T> {
        let turn = self.turn;
        self.turn = self.sines.turn(self.tile, self.layer.medium, self.first);
        // Beyond the last layer it is the last one's again, and not used.
        self.layer = self.above.next().unwrap_or(self.layer);
        self.sines = Sines::new(self.tile, self.layer, self.first);
        turn
    }
}

impl<const W: usize, T: Real> LosslessWave<W, T> {
    /// AVX2 has too few registers for what is computed ahead.
    const LOOKS_AHEAD: bool = W * size_of::<T>() >= 64;

    #[inline(always)]
    fn on_substrate(tile: &LosslessTile<T>, first: usize) -> Self {
        let (s, p) = (Rotor::on_substrate(tile, first, 0), Rotor::on_substrate(tile, first, 1));
        Self { rotors: [s, p], memories: [Memory::of(s.energy()), Memory::of(p.energy())] }
    }

    #[inline(always)]
    fn in_full(self) -> LosslessWave<W> {
        let rotors = self.rotors.map(|Rotor { b, c, emission }| Rotor {
            b: [b[0].cast(), b[1].cast()],
            c: [c[0].cast(), c[1].cast()],
            emission: emission.cast(),
        });
        let memories = self
            .memories
            .map(|Memory { exponent, most }| Memory { exponent: exponent.cast(), most: most.cast() });
        LosslessWave { rotors, memories }
    }

    #[inline(always)]
    fn look(&mut self) {
        for (memory, rotor) in self.memories.iter_mut().zip(&mut self.rotors) {
            if let Some(factor) = memory.look(rotor.energy()) {
                *rotor = rotor.scaled(factor);
            }
        }
    }

    /// Through all layers, by kind. The shears between layers are joined.
    #[inline(always)]
    fn turn_by_kind(&mut self, turns: &[Turn], kinds: &Kinds, first: usize) {
        for block in kinds.of_layer.chunks(look_every(kinds.of_layer.len())) {
            let [mut s, mut p] = self.rotors;
            let mut below = &Turn::NONE;
            for &kind in block {
                let turn = &turns[kind as usize];
                s = s
                    .shear_b((below.b[0].part(first)) + turn.b[0].part(first))
                    .shear_c(turn.c[0].part(first));
                p = p
                    .shear_b((below.b[1].part(first)) + turn.b[1].part(first))
                    .shear_c(turn.c[1].part(first));
                below = turn;
            }
            self.rotors = [s.shear_b(below.b[0].part(first)), p.shear_b(below.b[1].part(first))];
            self.look();
        }
    }

    /// Through all layers, by kind, with what they give off.
    #[inline(always)]
    fn turn_emitting_by_kind(
        &mut self,
        tile: &LosslessTile<T>,
        turns: &[Turn],
        stores: &[Store],
        kinds: &Kinds,
        first: usize,
    ) {
        let look_every = look_every(tile.layers.len());
        for (layers, block) in tile.layers.chunks(look_every).zip(kinds.of_layer.chunks(look_every)) {
            let [mut s, mut p] = self.rotors;
            let mut below = [s.standing(), p.standing()];
            for (layer, &kind) in layers.iter().zip(block) {
                let (turn, store) = (&turns[kind as usize], &stores[kind as usize]);
                let [b, c]: [[Lanes<W, T>; 2]; 2] =
                    [turn.b, turn.c].map(|[s, p]| [s.part(first), p.part(first)]);
                s = s.shear_b(b[0]).shear_c(c[0]).shear_b(b[0]);
                p = p.shear_b(b[1]).shear_c(c[1]).shear_b(b[1]);
                let above = [s.standing(), p.standing()];
                if layer.source != 0.0 {
                    s = s.give_off(layer.source, store, first, 0, above[0] - below[0]);
                    p = p.give_off(layer.source, store, first, 1, above[1] - below[1]);
                }
                below = above;
            }
            self.rotors = [s, p];
            self.look();
        }
    }

    /// Through all layers, one by one. Where nothing is emitted, the shears between layers are joined.
    #[inline(always)]
    fn turn<const EMITS: bool>(&mut self, tile: &LosslessTile<T>, first: usize) {
        let mut above = tile.layers.iter();
        let Some(lowest) = above.next() else { return };
        let mut turns = Turns::new(tile, lowest, above, first);
        for block in tile.layers.chunks(look_every(tile.layers.len())) {
            let [mut s, mut p] = self.rotors;
            let mut below = [Lanes::splat(T::ZERO); 2];
            for layer in block {
                let turn = if Self::LOOKS_AHEAD {
                    turns.next()
                } else {
                    Sines::new(tile, layer, first).turn(tile, layer.medium, first)
                };
                if !EMITS {
                    s = s.shear_b(below[0] + turn.b[0]).shear_c(turn.c[0]);
                    p = p.shear_b(below[1] + turn.b[1]).shear_c(turn.c[1]);
                    below = turn.b;
                    continue;
                }
                let standing = [s.standing(), p.standing()];
                s = s.shear_b(turn.b[0]).shear_c(turn.c[0]).shear_b(turn.b[0]);
                p = p.shear_b(turn.b[1]).shear_c(turn.c[1]).shear_b(turn.b[1]);
                if layer.source != 0.0 {
                    let medium = &tile.media[layer.medium];
                    s = s.emit(layer, medium, first, 0, standing[0]);
                    p = p.emit(layer, medium, first, 1, standing[1]);
                }
            }
            self.rotors = [s.shear_b(below[0]), p.shear_b(below[1])];
            self.look();
        }
    }
}

/// What a layer of a kind stores: weights in ∫|E|² of b² and c² at its upper face, and of what its standing wave gains; [s, p].
pub(super) struct Store {
    b: [Lanes; 2],
    c: [Lanes; 2],
    face: [Lanes; 2],
}

impl Store {
    #[inline(always)]
    fn new(layer: &DenseLayer, medium: &LosslessMedium) -> Self {
        let [s, p] = [medium.mean[0].scale(layer.thickness), medium.mean[1].scale(layer.thickness)];
        let [up_s, up_p] = medium.up;
        Self { b: [s, p], c: [s * up_s * up_s, p * up_p * up_p], face: medium.face }
    }
}

/// The shears of a layer; [s, p].
#[derive(Clone, Copy)]
pub(super) struct Turn<const W: usize = LANES, T = f64> {
    /// τ q_ref/q.
    b: [Lanes<W, T>; 2],
    /// −sin δ q/q_ref.
    c: [Lanes<W, T>; 2],
}

impl<const W: usize, T: Real> Turn<W, T> {
    const NONE: Self = Self { b: [Lanes::splat(T::ZERO); 2], c: [Lanes::splat(T::ZERO); 2] };
}

impl Turn {
    #[inline(always)]
    fn set_part<const W: usize>(&mut self, first: usize, part: Turn<W>) {
        for pol in 0..2 {
            self.b[pol].set_part(first, part.b[pol]);
            self.c[pol].set_part(first, part.c[pol]);
        }
    }
}

/// Sine and cosine of half a layer's phase, less whole half turns of the phase.
#[derive(Clone, Copy)]
struct Sines<const W: usize, T = f64> {
    sin: Lanes<W, T>,
    cos: Lanes<W, T>,
}

impl<const W: usize, T: Real> Sines<W, T> {
    #[inline(always)]
    fn new(tile: &LosslessTile<T>, layer: &DenseLayer, first: usize) -> Self {
        let medium = &tile.media[layer.medium];
        let half_turns = medium.half_turns.part::<W, f64>(first).scale(layer.thickness);
        let (sin, cos) = if medium.most_half_turns * layer.thickness <= FEW_HALF_TURNS {
            sin_cos_of_few_half_turns(half_turns)
        } else {
            sin_cos_of_half_turns(half_turns)
        };
        Self { sin, cos }
    }

    #[inline(always)]
    fn turn(self, tile: &LosslessTile<T>, medium: usize, first: usize) -> Turn<W, T> {
        let Self { sin, cos } = self;
        let (tan, minus_sin) = (sin / cos, -((sin + sin) * cos));
        if medium == tile.reference {
            return Turn { b: [tan; 2], c: [minus_sin; 2] };
        }
        let LosslessMedium { up, down, .. } = &tile.media[medium];
        Turn {
            b: [tan * up[0].part(first), tan * up[1].part(first)],
            c: [minus_sin * down[0].part(first), minus_sin * down[1].part(first)],
        }
    }
}

#[inline(always)]
fn finish_lossless<const W: usize, T>(
    tile: &LosslessTile<T>,
    first: usize,
    wave: &LosslessWave<W>,
    rounding_per_layer: f64,
    result: &mut TileResult,
) {
    let LosslessWave { rotors, memories } = wave;
    for (pol, rotor) in rotors.iter().enumerate() {
        let (q_0, q_ref) = (tile.q_ambient[pol].part(first), tile.q_reference[pol].part(first));
        // q₀B and C, real and imaginary parts; the second solution carries −Re C.
        let (b_re, b_im) = (q_0 * rotor.b[0], q_0 * rotor.b[1]);
        let (c_re, c_im) = (-(q_ref * rotor.c[1]), q_ref * rotor.c[0]);
        let reflected = square([b_re - c_re, b_im - c_im]);
        let incident = square([b_re + c_re, b_im + c_im]);
        // Most fields never grow so far as to be scaled, and a library function costs as much as a layer.
        let scale = memories[pol].exponent.map(|e| if e == 0.0 { 1.0 } else { (-2.0 * e).exp2() });
        let transmitted = (q_0 * tile.q_substrate[pol][0].part(first)).scale(4.0) * scale;
        let whole = reflected + transmitted;
        result.reflectance[pol].set_part(first, reflected / whole);
        result.transmittance[pol].set_part(first, transmitted / whole);
        // Rounding does not know of flux conservation: what it breaks is the measure of what it did.
        let broken = whole.zip(incident, |a, b| (a / b - 1.0).abs());
        // q_ref(B² + C²/q_ref²) stored against |q₀B + C|²/2q₀ coming in.
        let incoming = incident / (q_0 * q_ref).scale(2.0);
        let rounding = memories[pol].magnified_rounding(rounding_per_layer, tile.layers.len(), incoming);
        result.error[pol].set_part(first, broken + rounding);
        result.emission[pol].set_part(first, rotor.emission / incident * (q_0 * q_0).scale(4.0));
    }
}

/// What the complex loop needs of a medium.
#[derive(Clone, Copy, Debug)]
pub(super) struct ComplexMedium {
    /// Quarter turns of phase per metre there and back, 4 k₀ Re kz/π.
    pub(super) quarter_turns: Lanes,
    /// Binary logarithms of decay per metre there and back, 2 k₀ Im kz/ln 2.
    pub(super) decay: Lanes,
    /// The largest of them.
    pub(super) most_decay: f64,
    /// Thickness of all its layers, metres.
    pub(super) thickness: f64,
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
struct Amplitudes<const W: usize> {
    down: [Lanes<W>; 2],
    up: [Lanes<W>; 2],
    /// Π 1/|τ|.
    norm: Lanes<W>,
}

// By value throughout: the state must stay in registers.
impl<const W: usize> Amplitudes<W> {
    /// In the substrate.
    const INSIDE: Self = Self {
        down: [Lanes::splat(1.0), Lanes::splat(0.0)],
        up: [Lanes::splat(0.0); 2],
        norm: Lanes::splat(1.0),
    };

    #[inline(always)]
    fn interface(self, interface: &Interface, first: usize, pol: usize) -> Self {
        let [re, im]: [Lanes<W>; 2] = [interface.rho[pol][0].part(first), interface.rho[pol][1].part(first)];
        let (f, g) = (self.down, self.up);
        Self {
            down: [re.fma(g[0], im.fnma(g[1], f[0])), re.fma(g[1], im.fma(g[0], f[1]))],
            up: [re.fma(f[0], im.fnma(f[1], g[0])), re.fma(f[1], im.fma(f[0], g[1]))],
            norm: self.norm * interface.inverse_tau[pol].part(first),
        }
    }

    /// ∫|E|² over a layer from its lower face, where these amplitudes are, on the scale of its upper face.
    #[inline(always)]
    fn stored(&self, path: &Path<W>, medium: &ComplexMedium, first: usize, pol: usize) -> Lanes<W> {
        let (alone, together) = (medium.alone[pol].part::<W, f64>(first), medium.together[pol].part(first));
        let (f, g) = (self.down, self.up);
        let waves = path.shrink.fma(square(g), square(f)) * path.mean;
        let product = [f[0].fma(g[0], f[1] * g[1]), f[0].fnma(g[1], f[1] * g[0])];
        let standing = path.standing[0].fma(product[0], path.standing[1] * product[1]);
        alone.fma(waves, together * standing) * self.norm * self.norm
    }

    #[inline(always)]
    fn propagate(self, [re, im]: [Lanes<W>; 2]) -> Self {
        let g = self.up;
        Self { up: [im.fnma(g[1], re * g[0]), im.fma(g[0], re * g[1])], ..self }
    }

    /// Folds the norm into the amplitudes, so that energies at different faces can be compared.
    #[inline(always)]
    fn normalised(self) -> Self {
        Self { norm: Lanes::splat(1.0), ..self.scaled(self.norm) }
    }

    #[inline(always)]
    fn scaled(self, factor: Lanes<W>) -> Self {
        let Self { down, up, .. } = self;
        Self { down: [down[0] * factor, down[1] * factor], up: [up[0] * factor, up[1] * factor], ..self }
    }

    #[inline(always)]
    fn energy(&self) -> Lanes<W> {
        square(self.down) + square(self.up)
    }
}

/// What goes up through any stack; [s, p].
struct ComplexWave<const W: usize> {
    amplitudes: [Amplitudes<W>; 2],
    memories: [Memory<W>; 2],
    emission: [Lanes<W>; 2],
}

at_each_level! {
    /// Through any stack.
    pub(super) fn complex(tile: &ComplexTile, scratch: &mut Vec<Passage>) -> TileResult = through_any_stack[8, 4, 2]
}
at_each_level! {
    /// As `complex`, with sources.
    pub(super) fn complex_emitting(tile: &ComplexTile) -> TileResult = through_any_emitting_stack[8, 4, 2]
}

#[inline(always)]
fn through_any_stack<const W: usize>(tile: &ComplexTile, scratch: &mut Vec<Passage>) -> TileResult {
    let mut result = TileResult::UNKNOWN;
    for first in (0..LANES).step_by(W) {
        let mut wave = ComplexWave::<W>::INSIDE;
        match tile.kinds {
            Some(kinds) => {
                scratch.resize(kinds.layers.len(), [Lanes::splat(0.0); 2]);
                for (layer, slot) in kinds.layers.iter().zip(scratch.iter_mut()) {
                    let [re, im] = passage::<W>(&tile.media[layer.medium], layer, first).0;
                    slot[0].set_part(first, re);
                    slot[1].set_part(first, im);
                }
                let passages = PassagesByKind { passages: scratch, of_layer: &kinds.of_layer, first };
                wave.pass(tile, first, &passages);
            }
            None => wave.pass(tile, first, &PassagesOneByOne { tile, first }),
        }
        finish_complex(tile, first, &wave, &mut result);
    }
    result
}

#[inline(always)]
fn through_any_emitting_stack<const W: usize>(tile: &ComplexTile) -> TileResult {
    let mut result = TileResult::UNKNOWN;
    for first in (0..LANES).step_by(W) {
        let mut wave = ComplexWave::<W>::INSIDE;
        wave.pass_emitting(tile, first);
        finish_complex(tile, first, &wave, &mut result);
    }
    result
}

/// e^(2iδ) of a layer as (Re, Im).
pub(super) type Passage<const W: usize = LANES> = [Lanes<W>; 2];

/// The passage of a layer, and |e^(2iδ)|.
#[inline(always)]
fn passage<const W: usize>(
    medium: &ComplexMedium,
    layer: &DenseLayer,
    first: usize,
) -> (Passage<W>, Lanes<W>) {
    let (cos, sin) = cos_sin_quarter_turns(medium.quarter_turns.part::<W, f64>(first).scale(layer.thickness));
    let decay = medium.decay.part::<W, f64>(first).scale(layer.thickness);
    let shrink = if medium.most_decay * layer.thickness <= LITTLE_DECAY {
        exp2_neg_of_little(decay)
    } else {
        exp2_neg(decay)
    };
    ([cos * shrink, sin * shrink], shrink)
}

/// Where the passages of layers come from.
trait Passages<const W: usize> {
    fn of(&self, layer: usize) -> Passage<W>;
}

/// From a table.
struct PassagesByKind<'a> {
    passages: &'a [Passage],
    of_layer: &'a [u32],
    first: usize,
}

impl<const W: usize> Passages<W> for PassagesByKind<'_> {
    #[inline(always)]
    fn of(&self, layer: usize) -> Passage<W> {
        let [re, im] = &self.passages[self.of_layer[layer] as usize];
        [re.part(self.first), im.part(self.first)]
    }
}

/// Each computed.
struct PassagesOneByOne<'a> {
    tile: &'a ComplexTile<'a>,
    first: usize,
}

impl<const W: usize> Passages<W> for PassagesOneByOne<'_> {
    #[inline(always)]
    fn of(&self, layer: usize) -> Passage<W> {
        let layer = &self.tile.layers[layer];
        passage(&self.tile.media[layer.medium], layer, self.first).0
    }
}

/// Way through a layer of an energy, metres.
struct Path<const W: usize> {
    /// Of a wave by itself, on the scale of its stronger end.
    mean: Lanes<W>,
    /// Of twice the real part of f·ḡ, and of its imaginary part.
    standing: [Lanes<W>; 2],
    /// |e^(2iδ)|.
    shrink: Lanes<W>,
}

impl<const W: usize> Path<W> {
    #[inline(always)]
    fn new(
        medium: &ComplexMedium,
        layer: &DenseLayer,
        first: usize,
        [re, im]: Passage<W>,
        shrink: Lanes<W>,
    ) -> Self {
        // (1 − e^−x)/x: a short series where 1 − e^−x has lost digits.
        const FEW: f64 = 1e-3;
        const SERIES: [f64; 5] = [1.0, -0.5, 1.0 / 6.0, -1.0 / 24.0, 1.0 / 120.0];
        let decay = medium.decay.part::<W, f64>(first).scale(layer.thickness);
        let x = decay.scale(std::f64::consts::LN_2);
        let series = x.polynomial(&SERIES);
        let whole = (Lanes::splat(1.0) - shrink) / x;
        let mut mean = series;
        for i in 0..W {
            mean.0[i] = if x.0[i] < FEW { series.0[i] } else { whole.0[i] };
        }
        let phase_per_metre = medium.quarter_turns.part::<W, f64>(first).scale(std::f64::consts::FRAC_PI_2);
        let per_phase = Lanes::splat(2.0) / phase_per_metre;
        Self {
            mean: mean.scale(layer.thickness),
            standing: [im * per_phase, (shrink - re) * per_phase],
            shrink,
        }
    }
}

impl<const W: usize> ComplexWave<W> {
    const INSIDE: Self = Self {
        amplitudes: [Amplitudes::INSIDE; 2],
        memories: [Memory { exponent: Lanes::splat(0.0), most: Lanes::splat(1.0) }; 2],
        emission: [Lanes::splat(0.0); 2],
    };

    #[inline(always)]
    fn look(&mut self) {
        for pol in 0..2 {
            let wave = self.amplitudes[pol].normalised();
            self.amplitudes[pol] = wave;
            if let Some(factor) = self.memories[pol].look(wave.energy()) {
                self.amplitudes[pol] = wave.scaled(factor);
                self.emission[pol] = self.emission[pol] * factor * factor;
            }
        }
    }

    #[inline(always)]
    fn pass(&mut self, tile: &ComplexTile, first: usize, passages: &impl Passages<W>) {
        let count = tile.layers.len();
        let look_every = look_every(count);
        let mut from = 0;
        while from < count {
            let to = (from + look_every).min(count);
            let [mut s, mut p] = self.amplitudes;
            for at in from..to {
                let passage = passages.of(at);
                let interface = &tile.interfaces[tile.interface_of[at]];
                s = s.interface(interface, first, 0).propagate(passage);
                p = p.interface(interface, first, 1).propagate(passage);
            }
            self.amplitudes = [s, p];
            self.look();
            from = to;
        }
    }

    #[inline(always)]
    fn pass_emitting(&mut self, tile: &ComplexTile, first: usize) {
        let look_every = look_every(tile.layers.len());
        for (block, interfaces) in tile.layers.chunks(look_every).zip(tile.interface_of.chunks(look_every)) {
            let ([mut s, mut p], [mut of_s, mut of_p]) = (self.amplitudes, self.emission);
            for (layer, &at) in block.iter().zip(interfaces) {
                let (medium, interface) = (&tile.media[layer.medium], &tile.interfaces[at]);
                let (turn, shrink) = passage(medium, layer, first);
                let path = Path::new(medium, layer, first, turn, shrink);
                s = s.interface(interface, first, 0);
                p = p.interface(interface, first, 1);
                of_s = of_s.fma(path.shrink, s.stored(&path, medium, first, 0).scale(layer.source));
                of_p = of_p.fma(path.shrink, p.stored(&path, medium, first, 1).scale(layer.source));
                (s, p) = (s.propagate(turn), p.propagate(turn));
            }
            (self.amplitudes, self.emission) = ([s, p], [of_s, of_p]);
            self.look();
        }
    }
}

#[inline(always)]
fn finish_complex<const W: usize>(
    tile: &ComplexTile,
    first: usize,
    wave: &ComplexWave<W>,
    result: &mut TileResult,
) {
    let top = &tile.interfaces[tile.interface_of[tile.layers.len()]];
    let mut total_decay = Lanes::<W>::splat(0.0);
    for medium in tile.media {
        total_decay = medium.decay.part::<W, f64>(first).fma(Lanes::splat(medium.thickness), total_decay);
    }
    for pol in 0..2 {
        let memory = &wave.memories[pol];
        let wave_at_top = wave.amplitudes[pol].interface(top, first, pol).normalised();
        let (down, up) = (square(wave_at_top.down), square(wave_at_top.up));
        result.reflectance[pol].set_part(first, up / down);
        let power = memory.exponent.zip(total_decay, |e, decay| (-2.0 * e - decay).exp2());
        result.transmittance[pol].set_part(first, power * tile.flux[pol].part(first) / down);
        // Of unit |ψ| in the substrate.
        result.emission[pol].set_part(first, wave.emission[pol] / down);
        let incoming = down * tile.inverse_contrast[pol].part(first);
        let rounding = memory.magnified_rounding(AMPLITUDE_ROUNDING, tile.layers.len(), incoming);
        result.error[pol].set_part(first, rounding);
    }
}
