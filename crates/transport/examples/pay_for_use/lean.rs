//! A walk written for one case: unpolarised light in the plane, in a lossless periodic stack, with small tilts.
//!
//! `docs/WALK.md` describes the method. Nothing here can be switched: what this walk does not name it does not have.

use std::hint::select_unpredictable as choose;

use transport::Transport;
use transport::walk::{Exit, Fate};

const LANES: usize = 128;
const BLOCK: usize = 16;
const IDLE: usize = usize::MAX;
const CROSSING: u32 = 4;
const ENTERED: u32 = 2;
/// Crossings after which a path is cut: never, here.
const EVENT_CAP: u32 = u32::MAX / CROSSING - 1;

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;
const STREAMS: u64 = 0x243f_6a88_85a3_08d3;

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// What all paths of one incidence share.
#[derive(Clone, Copy)]
struct Stream([u64; 2]);

impl Stream {
    fn new(seed: u64, theta_i: f64) -> Self {
        let first =
            mix(mix((seed ^ STREAMS).wrapping_add(GOLDEN)) ^ mix(theta_i.to_bits().wrapping_add(GOLDEN)));
        Self([first, mix(first.wrapping_add(GOLDEN))])
    }

    /// The state of a path's xoshiro128+.
    #[inline(always)]
    fn path(self, path: u64) -> [u32; 4] {
        let counter = mix(path.wrapping_mul(GOLDEN).wrapping_add(self.0[0]));
        let low = mix(counter ^ self.0[1]);
        let high = mix(low.wrapping_add(GOLDEN).wrapping_add(counter));
        [low as u32, (low >> 32) as u32, high as u32, (high >> 32) as u32 | 1]
    }
}

#[inline(always)]
fn next(state: &mut [u32; 4]) -> u32 {
    let [s0, s1, s2, s3] = *state;
    let (t2, t3) = (s2 ^ s0, s3 ^ s1);
    *state = [s0 ^ t3, s1 ^ t2, t2 ^ (s1 << 9), t3.rotate_left(11)];
    s0.wrapping_add(s3)
}

#[inline(always)]
fn odd(word: u32) -> f32 {
    (word | 1) as i32 as f32
}

#[inline(always)]
fn polynomial<const N: usize>(coefficients: &[f32; N], x: f32) -> f32 {
    let mut sum = coefficients[N - 1];
    for k in (0..N - 1).rev() {
        sum = sum.mul_add(x, coefficients[k]);
    }
    sum
}

/// A path on its way, mirrored so that it always travels towards +z.
#[derive(Clone, Copy)]
struct Ray {
    x: f32,
    z: f32,
    interface: i32,
    step: i32,
    met: u32,
}

/// The stack, and the law of its tilts.
#[derive(Clone, Copy)]
pub(crate) struct Lean {
    last: i32,
    odd: f32,
    even: f32,
    enter: f32,
    leave: f32,
    octave: f32,
    log: [f32; 8],
}

impl Lean {
    /// Out of line: else the compiler chooses between indices of 64 bits and rounds the choice, at every crossing.
    #[inline(never)]
    pub(crate) fn new(transport: &Transport) -> Self {
        const LOG: [f64; 8] = [
            -2.249_635_396_0,
            4.944_890_813_8,
            -5.194_534_754_2,
            4.007_387_706_0,
            -2.069_058_603_1,
            0.677_963_540_35,
            -0.127_497_211_51,
            0.010_484_096_913,
        ];
        let scale = -2.0 * transport.facets.slope_sd.powi(2);
        let ratio = |from: usize, to: usize| (transport.indices[from] / transport.indices[to]) as f32;
        Self {
            last: transport.layers() as i32,
            odd: ratio(1, 2),
            even: ratio(2, 1),
            enter: ratio(0, 1),
            leave: ratio(1, 0),
            octave: (scale * std::f64::consts::LN_2) as f32,
            log: LOG.map(|c| (scale * c) as f32),
        }
    }

    /// Two tilts and two choices, of three words.
    #[inline(always)]
    fn draw(&self, generator: &mut [u32; 4]) -> [f32; 4] {
        const SIN: [f32; 4] = [1.570_791_011_1, -0.645_892_849_55, 0.079_434_344_612, -0.004_333_095_289_8];
        const COS: [f32; 5] =
            [0.999_999_995_35, -1.233_698_214_7, 0.253_650_744_64, -0.020_810_627_519, 0.000_858_190_619_53];
        let (radius_word, angle_word) = (next(generator), next(generator));
        let uniform = odd(radius_word);
        let bits = uniform.abs().to_bits();
        let e = (bits.wrapping_sub((127 + 31) << 23) as i32 >> 23) as f32;
        let v = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000);
        let [constant, linear @ ..] = self.log;
        let square = polynomial(&linear, v).mul_add(v, e.mul_add(self.octave, constant));
        let radius = choose(square > 0.0, square, 0.0).sqrt().copysign(uniform);
        let t = ((angle_word << 16) as i32) as f32 * (1.0 / 2_147_483_648.0);
        let z = t * t;
        let left_over = ((angle_word & 0xffff_0000) | (radius_word & 0xffff)) & 0x7fff_ffff;
        let choices = [odd(left_over), odd(next(generator) & 0x7fff_ffff)];
        [radius * polynomial(&COS, z), radius * t * polynomial(&SIN, z), choices[0], choices[1]]
    }

    /// An event: the ray meets a facet of tilt `alpha`. A ray that rests stays as it is.
    #[inline(always)]
    fn meet(&self, ray: Ray, alpha: f32, choice: f32, rests: bool) -> Ray {
        const SIN: [f32; 3] = [9.999_999_916_104e-1, -1.666_657_457_094e-1, 8.308_054_673_418e-3];
        const COS: [f32; 3] = [9.999_999_832_286e-1, -4.999_958_571_152e-1, 4.151_503_033_840e-2];
        let (up, square) = (ray.step < 0, alpha * alpha);
        let facet = [alpha * polynomial(&SIN, square), polynomial(&COS, square)];
        let inner = choose(up ^ (ray.interface & 1 != 0), self.odd, self.even);
        let ratio = choose(ray.interface == 0, choose(up, self.leave, self.enter), inner);
        let a = (-ray.x).mul_add(facet[0], ray.z * facet[1]);
        let a = choose((a > 0.0) & !rests, a, 0.0);
        let faces = a > 0.0;
        let scaled = a * ratio;
        let square = scaled.mul_add(scaled, (-ratio).mul_add(ratio, 1.0));
        let b = choose(square > 0.0, square, 0.0).sqrt();
        let (sd, sn) = (scaled + b, scaled - b);
        let (pd, pn) = (ratio.mul_add(b, a), (-ratio).mul_add(b, a));
        let (both, s, p) = (sd * pd, sn * pd, pn * sd);
        let reflects = choice * both * both <= 1_073_742_080.0 * s.mul_add(s, p * p);
        let along = choose(reflects, 1.0, ratio);
        let normal = choose(reflects, a + a, sn);
        let z = ray.z.mul_add(along, -(normal * facet[1]));
        let turns = faces & (z <= 0.0);
        let step = choose(turns, -ray.step, ray.step);
        let met = ray.met + choose(faces, CROSSING, 0);
        Ray {
            x: ray.x.mul_add(along, normal * facet[0]),
            z: z.abs(),
            interface: choose(reflects == turns, ray.interface + step, ray.interface),
            step,
            met: choose(reflects, met, met | ENTERED),
        }
    }

    #[inline(always)]
    fn is_out(&self, ray: &Ray) -> bool {
        ray.interface as u32 > self.last as u32
    }

    #[inline(always)]
    fn exit(&self, ray: &Ray) -> Exit {
        let fate = if ray.interface < 0 {
            match ray.met {
                CROSSING => Fate::Single,
                met if met & ENTERED == 0 => Fate::Rehit,
                _ => Fate::Interior,
            }
        } else if ray.interface > self.last {
            Fate::Transmitted
        } else {
            Fate::Truncated
        };
        Exit { direction: [ray.x, 0.0, ray.z], weight: 1.0, fate }
    }
}

struct Lanes {
    x: [f32; LANES],
    z: [f32; LANES],
    interface: [i32; LANES],
    step: [i32; LANES],
    met: [u32; LANES],
    drawn: [[f32; LANES]; 4],
    generator: [[u32; LANES]; 4],
    done: [i32; LANES],
    slot: [usize; LANES],
}

impl Lanes {
    fn idle(lean: &Lean) -> Self {
        let mut lanes = Self {
            x: [0.0; LANES],
            z: [1.0; LANES],
            interface: [0; LANES],
            step: [1; LANES],
            met: [0; LANES],
            drawn: [[0.0; LANES]; 4],
            generator: [[1; LANES]; 4],
            done: [0; LANES],
            slot: [IDLE; LANES],
        };
        (0..LANES).for_each(|lane| lanes.rest(lane, lean));
        lanes
    }

    fn rest(&mut self, lane: usize, lean: &Lean) {
        self.set(lane, Ray { x: 0.0, z: 1.0, interface: lean.last / 2, step: 1, met: 0 });
        self.slot[lane] = IDLE;
        self.set_generator(lane, [1 + lane as u32; 4]);
    }

    #[inline(always)]
    fn get(&self, lane: usize) -> Ray {
        Ray {
            x: self.x[lane],
            z: self.z[lane],
            interface: self.interface[lane],
            step: self.step[lane],
            met: self.met[lane],
        }
    }

    #[inline(always)]
    fn set(&mut self, lane: usize, ray: Ray) {
        self.x[lane] = ray.x;
        self.z[lane] = ray.z;
        self.interface[lane] = ray.interface;
        self.step[lane] = ray.step;
        self.met[lane] = ray.met;
    }

    #[inline(always)]
    fn generator(&self, lane: usize) -> [u32; 4] {
        let [s0, s1, s2, s3] = &self.generator;
        [s0[lane], s1[lane], s2[lane], s3[lane]]
    }

    #[inline(always)]
    fn set_generator(&mut self, lane: usize, state: [u32; 4]) {
        let [s0, s1, s2, s3] = &mut self.generator;
        [s0[lane], s1[lane], s2[lane], s3[lane]] = state;
    }

    #[inline(always)]
    fn start(&mut self, lane: usize, paths: &Paths, path: u64) {
        let [x, z] = paths.incidence;
        self.set(lane, Ray { x, z, interface: 0, step: 1, met: 0 });
        self.set_generator(lane, paths.stream.path(path));
        self.slot[lane] = path as usize;
    }

    fn shift(&mut self, from: usize, to: usize) {
        self.set(to, self.get(from));
        self.set_generator(to, self.generator(from));
        self.slot[to] = self.slot[from];
    }

    #[inline(always)]
    fn sweep(&mut self, lean: Lean, count: usize) -> bool {
        let count = count.min(LANES);
        for lane in 0..count {
            let mut generator = self.generator(lane);
            let [first, second, choice, other] = &mut self.drawn;
            [first[lane], second[lane], choice[lane], other[lane]] = lean.draw(&mut generator);
            self.set_generator(lane, generator);
        }
        let mut any = 0;
        for lane in 0..count {
            let [first, second, choice, other] = &self.drawn;
            let mut ray = lean.meet(self.get(lane), first[lane], choice[lane], false);
            // A path that ended in the first event of a sweep rests in the second.
            let mut done = -i32::from(lean.is_out(&ray));
            ray = lean.meet(ray, second[lane], other[lane], done != 0);
            done = -i32::from(lean.is_out(&ray));
            any |= done;
            self.done[lane] = done;
            self.set(lane, ray);
        }
        any != 0
    }

    #[inline(never)]
    fn cut(&mut self) -> u32 {
        let mut most = 0;
        for lane in 0..LANES {
            let crossings = self.met[lane] / CROSSING;
            if crossings >= EVENT_CAP {
                self.done[lane] = -1;
            } else if self.slot[lane] != IDLE {
                most = most.max(crossings);
            }
        }
        (EVENT_CAP - most).div_ceil(2)
    }
}

/// The paths of a call.
struct Paths {
    stream: Stream,
    incidence: [f32; 2],
}

/// Walks paths from number 0 at an incidence (radians), one for each exit; the number of crossings.
#[inline(always)]
pub(crate) fn walk(lean: &Lean, theta_i: f64, seed: u64, out: &mut [Exit]) -> u64 {
    let paths =
        Paths { stream: Stream::new(seed, theta_i), incidence: [theta_i.sin() as f32, theta_i.cos() as f32] };
    let mut lanes = Lanes::idle(lean);
    let mut waiting = 0..out.len() as u64;
    let mut live = 0_usize;
    for (lane, path) in (0..LANES).zip(waiting.by_ref()) {
        lanes.start(lane, &paths, path);
        live += 1;
    }
    let mut harvest = Harvest { lean, paths, waiting, live, crossings: 0, out };
    let mut until_cut = lanes.cut();
    while harvest.live > 0 {
        let count = harvest.live.next_multiple_of(BLOCK);
        let mut any = lanes.sweep(*lean, count);
        until_cut -= 1;
        if until_cut == 0 {
            until_cut = lanes.cut();
            any = true;
        }
        if !any {
            continue;
        }
        for block in (0..count / BLOCK).rev() {
            let first = block * BLOCK;
            if lanes.done[first..first + BLOCK].iter().fold(0, |any, done| any | done) != 0 {
                harvest.block(&mut lanes, first);
            }
        }
    }
    harvest.crossings
}

struct Harvest<'a> {
    lean: &'a Lean,
    paths: Paths,
    /// Paths that wait for a lane.
    waiting: std::ops::Range<u64>,
    live: usize,
    crossings: u64,
    out: &'a mut [Exit],
}

impl Harvest<'_> {
    #[inline(never)]
    fn block(&mut self, lanes: &mut Lanes, first: usize) {
        for lane in (first..first + BLOCK).rev() {
            if lanes.done[lane] == 0 {
                continue;
            }
            if lanes.slot[lane] == IDLE {
                lanes.rest(lane, self.lean);
                continue;
            }
            self.crossings += u64::from(lanes.met[lane] / CROSSING);
            self.out[lanes.slot[lane]] = self.lean.exit(&lanes.get(lane));
            if let Some(path) = self.waiting.next() {
                lanes.start(lane, &self.paths, path);
                continue;
            }
            self.live -= 1;
            lanes.shift(self.live, lane);
            lanes.rest(self.live, self.lean);
        }
    }
}
