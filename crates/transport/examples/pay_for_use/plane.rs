//! A plane walk that knows one thing: unpolarised light in a lossless periodic stack, facets unweighted, tilts small.
//!
//! Nothing here can be switched: no absorption, no visible normals, no tracked polarisation, no sheets, no explicit stack, no
//! direction out of the plane.

use std::hint::select_unpredictable as choose;
use std::ops::Range;

use transport::Transport;
use transport::walk::{Exit, Fate};

use super::draws::{Normal, Stream, left_over, next, polynomial, uniform};

const LANES: usize = 128;
const BLOCK: usize = 16;
const IDLE: usize = usize::MAX;
const CROSSING: u32 = 4;
const ENTERED: u32 = 2;

struct Lanes {
    x: [f32; LANES],
    z: [f32; LANES],
    interface: [i32; LANES],
    step: [i32; LANES],
    met: [u32; LANES],
    tilts: [[f32; LANES]; 2],
    choices: [[f32; LANES]; 2],
    generator: [[u32; LANES]; 4],
    done: [i32; LANES],
    slot: [usize; LANES],
}

#[derive(Clone, Copy)]
struct Stack {
    last: i32,
    odd: f32,
    even: f32,
    enter: f32,
    leave: f32,
    normal: Normal,
}

#[derive(Clone, Copy)]
struct Ray {
    x: f32,
    z: f32,
    interface: i32,
    step: i32,
    met: u32,
}

impl Stack {
    /// Out of line: else the compiler chooses between indices of 64 bits and rounds the choice, at every crossing.
    #[inline(never)]
    fn new(transport: &Transport) -> Self {
        let n = &transport.indices;
        let ratio = |from: usize, to: usize| (n[from] / n[to]) as f32;
        Self {
            last: transport.layers() as i32,
            odd: ratio(1, 2),
            even: ratio(2, 1),
            enter: ratio(0, 1),
            leave: ratio(1, 0),
            normal: Normal::new(transport.facets.slope_sd),
        }
    }

    #[inline(always)]
    fn meet(&self, ray: Ray, alpha: f32, choice: f32, rests: bool) -> Ray {
        const SIN: [f32; 3] = [9.999_999_916_104e-1, -1.666_657_457_094e-1, 8.308_054_673_418e-3];
        const COS: [f32; 3] = [9.999_999_832_286e-1, -4.999_958_571_152e-1, 4.151_503_033_840e-2];
        let square = alpha * alpha;
        let (facet_x, facet_z) = (alpha * polynomial(&SIN, square), polynomial(&COS, square));
        let up = ray.step < 0;
        let inner = choose(up ^ (ray.interface & 1 != 0), self.odd, self.even);
        let ratio = choose(ray.interface == 0, choose(up, self.leave, self.enter), inner);
        let contrast = (-ratio).mul_add(ratio, 1.0);
        let a = (-ray.x).mul_add(facet_x, ray.z * facet_z);
        let a = choose((a > 0.0) & !rests, a, 0.0);
        let faces = a > 0.0;
        let scaled = a * ratio;
        let square = scaled.mul_add(scaled, contrast);
        let b = choose(square > 0.0, square, 0.0).sqrt();
        let (sd, sn) = (scaled + b, scaled - b);
        let (pd, pn) = (ratio.mul_add(b, a), (-ratio).mul_add(b, a));
        let (both, s, p) = (sd * pd, sn * pd, pn * sd);
        let reflects = choice * both * both <= 1_073_742_080.0 * s.mul_add(s, p * p);
        let along = choose(reflects, 1.0, ratio);
        let normal = choose(reflects, a + a, sn);
        let z = ray.z.mul_add(along, -(normal * facet_z));
        let turns = faces & (z <= 0.0);
        let step = choose(turns, -ray.step, ray.step);
        let met = ray.met + choose(faces, CROSSING, 0);
        Ray {
            x: ray.x.mul_add(along, normal * facet_x),
            z: z.abs(),
            interface: choose(reflects == turns, ray.interface + step, ray.interface),
            step,
            met: choose(reflects, met, met | ENTERED),
        }
    }
}

impl Lanes {
    fn idle(stack: &Stack) -> Self {
        let mut lanes = Self {
            x: [0.0; LANES],
            z: [1.0; LANES],
            interface: [0; LANES],
            step: [1; LANES],
            met: [0; LANES],
            tilts: [[0.0; LANES]; 2],
            choices: [[0.0; LANES]; 2],
            generator: [[1; LANES]; 4],
            done: [0; LANES],
            slot: [IDLE; LANES],
        };
        (0..LANES).for_each(|lane| lanes.rest(lane, stack));
        lanes
    }

    fn rest(&mut self, lane: usize, stack: &Stack) {
        self.set(lane, Ray { x: 0.0, z: 1.0, interface: stack.last / 2, step: 1, met: 0 });
        self.slot[lane] = IDLE;
        (0..4).for_each(|word| self.generator[word][lane] = 1 + lane as u32);
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
    fn start(&mut self, lane: usize, [sin, cos]: [f32; 2], state: [u32; 4], slot: usize) {
        self.set(lane, Ray { x: sin, z: cos, interface: 0, step: 1, met: 0 });
        (0..4).for_each(|word| self.generator[word][lane] = state[word]);
        self.slot[lane] = slot;
    }

    fn shift(&mut self, from: usize, to: usize) {
        self.set(to, self.get(from));
        (0..4).for_each(|word| self.generator[word][to] = self.generator[word][from]);
        self.slot[to] = self.slot[from];
    }

    #[inline(always)]
    fn sweep(&mut self, stack: &Stack, count: usize) -> bool {
        let count = count.min(LANES);
        self.draw(stack.normal, count);
        self.move_on(*stack, count)
    }

    #[inline(always)]
    fn draw(&mut self, normal: Normal, count: usize) {
        for lane in 0..count {
            let [s0, s1, s2, s3] = &self.generator;
            let mut state = [s0[lane], s1[lane], s2[lane], s3[lane]];
            let (radius, angle) = (next(&mut state), next(&mut state));
            let (first, second) = normal.deviates(radius, angle);
            self.tilts[0][lane] = first;
            self.tilts[1][lane] = second;
            self.choices[0][lane] = left_over(radius, angle);
            self.choices[1][lane] = uniform(next(&mut state));
            let [s0, s1, s2, s3] = &mut self.generator;
            [s0[lane], s1[lane], s2[lane], s3[lane]] = state;
        }
    }

    #[inline(always)]
    fn move_on(&mut self, stack: Stack, count: usize) -> bool {
        let mut any = 0;
        for lane in 0..count {
            let mut ray = self.get(lane);
            let mut done = 0;
            for half in 0..2 {
                // A path that ended in the first half of a sweep rests in the second.
                let rests = half == 1 && done != 0;
                ray = stack.meet(ray, self.tilts[half][lane], self.choices[half][lane], rests);
                done = -i32::from(ray.interface as u32 > stack.last as u32);
            }
            any |= done;
            self.done[lane] = done;
            self.set(lane, ray);
        }
        any != 0
    }

    #[inline(never)]
    fn cut(&mut self, event_cap: u32) -> u32 {
        let mut most = 0;
        for lane in 0..LANES {
            let crossings = self.met[lane] / CROSSING;
            if crossings >= event_cap {
                self.done[lane] = -1;
            } else if self.slot[lane] != IDLE {
                most = most.max(crossings);
            }
        }
        (event_cap - most).div_ceil(2)
    }

    #[inline(always)]
    fn exit(&self, lane: usize, last: i32) -> Exit {
        let ray = self.get(lane);
        let fate = if ray.interface < 0 {
            match ray.met {
                CROSSING => Fate::Single,
                met if met & ENTERED == 0 => Fate::Rehit,
                _ => Fate::Interior,
            }
        } else if ray.interface > last {
            Fate::Transmitted
        } else {
            Fate::Truncated
        };
        Exit { direction: [ray.x, 0.0, ray.z], weight: 1.0, fate }
    }
}

/// Walks numbered paths of an incidence (radians); the number of crossings.
#[inline(always)]
pub(crate) fn walk(
    transport: &Transport,
    theta_i: f64,
    seed: u64,
    paths: Range<u64>,
    out: &mut [Exit],
) -> u64 {
    let stack = Stack::new(transport);
    let stream = Stream::new(seed, theta_i);
    let direction = [theta_i.sin() as f32, theta_i.cos() as f32];
    let event_cap = u32::MAX / CROSSING - 1;
    let first = paths.start;
    let mut lanes = Lanes::idle(&stack);
    let mut paths = paths;
    let mut live = 0_usize;
    for (lane, path) in (0..LANES).zip(paths.by_ref()) {
        lanes.start(lane, direction, stream.path(path), (path - first) as usize);
        live += 1;
    }
    let mut harvest = Harvest { stack: &stack, stream, direction, first, paths, live, crossings: 0, out };
    let mut until_cut = lanes.cut(event_cap);
    while harvest.live > 0 {
        let count = harvest.live.next_multiple_of(BLOCK);
        let mut any = lanes.sweep(&stack, count);
        until_cut -= 1;
        if until_cut == 0 {
            until_cut = lanes.cut(event_cap);
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
    stack: &'a Stack,
    stream: Stream,
    direction: [f32; 2],
    first: u64,
    paths: Range<u64>,
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
                lanes.rest(lane, self.stack);
                continue;
            }
            self.crossings += u64::from(lanes.met[lane] / CROSSING);
            self.out[lanes.slot[lane]] = lanes.exit(lane, self.stack.last);
            if let Some(path) = self.paths.next() {
                lanes.start(lane, self.direction, self.stream.path(path), (path - self.first) as usize);
                continue;
            }
            self.live -= 1;
            lanes.shift(self.live, lane);
            lanes.rest(self.live, self.stack);
        }
    }
}
