//! Lanes of paths: sweep, harvest, refill.

use std::ops::Range;

use super::draws::{Generator, Normal, Pair, Stream, uniform};
use super::event::{Ahead, CROSSING, ComplexFace, Constants, ENTERED, Facet, Problem, Ray};
use super::kernel::{Kernel, Sweep};
use super::real::Real;
use crate::Light;
use crate::walk::{Exit, Fate};

/// Paths that one sweep moves on by one event (two in the plane): enough independent chains to hide the latency of
/// the square root and the division, few enough to stay in the first-level cache.
const LANES: usize = 128;
/// Lanes are dropped by the block when paths run out.
const BLOCK: usize = 16;
/// Slot of a lane that carries no path.
const IDLE: usize = usize::MAX;

/// Optical depth up to which absorption is a weight; beyond it a path survives with probability exp(−(τ − τ0)),
/// which is unbiased and bounds the events spent on light that is gone.
const WEIGHT_DEPTH: f64 = 6.0;

/// One call: some paths of one incidence.
#[derive(Clone, Debug)]
pub(crate) struct Job {
    pub(crate) sin_i: f64,
    pub(crate) cos_i: f64,
    pub(crate) stream: Stream,
    pub(crate) paths: Range<u64>,
    pub(crate) event_cap: u32,
    pub(crate) light: Light,
    pub(crate) absorbs: bool,
}

/// The random numbers of all lanes, one array a variable.
pub(crate) struct Draws {
    /// Of this sweep: tilts (or slopes), uniforms for the choice and for the projected area.
    tilts: [[f32; LANES]; 2],
    choices: [[f32; LANES]; 2],
    weights: [[f32; LANES]; 2],
    generator: [[u32; LANES]; 4],
}

/// The state of all lanes, one array a variable.
pub(crate) struct Lanes<R> {
    x: [R; LANES],
    y: [R; LANES],
    z: [R; LANES],
    interface: [i32; LANES],
    step: [i32; LANES],
    met: [u32; LANES],
    depth: [R; LANES],
    limit: [R; LANES],
    /// Tracked light: −1 for s, 0 for p.
    polarisation: [i32; LANES],
    /// Explicit stacks: see [`Ahead`].
    ratio: [R; LANES],
    here: [R; LANES],
    beyond: [R; LANES],
    face: [ComplexFace<R>; LANES],
    pub(crate) draws: Draws,
    done: [i32; LANES],
    slot: [usize; LANES],
}

impl Draws {
    /// Draws the random numbers of a sweep.
    #[inline(always)]
    pub(crate) fn draw<const SPACE: bool, const VISIBLE: bool, const FUSED: bool>(
        &mut self,
        normal: Normal,
        count: usize,
    ) {
        for lane in 0..count.min(LANES) {
            let mut generator = self.generator(lane);
            let pair = Pair::draw(&mut generator);
            let (first, second) = normal.deviates::<FUSED>(pair);
            self.tilts[0][lane] = first;
            self.tilts[1][lane] = second;
            self.choices[0][lane] = pair.choice();
            if VISIBLE {
                self.weights[0][lane] = uniform(generator.next());
            }
            if !SPACE {
                self.choices[1][lane] = uniform(generator.next());
                if VISIBLE {
                    self.weights[1][lane] = uniform(generator.next());
                }
            }
            self.set_generator(lane, generator.state);
        }
    }

    #[inline(always)]
    fn generator(&self, lane: usize) -> Generator {
        let [s0, s1, s2, s3] = &self.generator;
        Generator { state: [s0[lane], s1[lane], s2[lane], s3[lane]] }
    }

    #[inline(always)]
    fn set_generator(&mut self, lane: usize, state: [u32; 4]) {
        let [s0, s1, s2, s3] = &mut self.generator;
        [s0[lane], s1[lane], s2[lane], s3[lane]] = state;
    }
}

impl<R: Real> Lanes<R> {
    fn idle(problem: &Problem<R>) -> Self {
        let mut lanes = Self {
            x: [R::ZERO; LANES],
            y: [R::ZERO; LANES],
            z: [R::ONE; LANES],
            interface: [0; LANES],
            step: [1; LANES],
            met: [0; LANES],
            depth: [R::ZERO; LANES],
            limit: [R::ZERO; LANES],
            polarisation: [0; LANES],
            ratio: [R::ONE; LANES],
            here: [R::ZERO; LANES],
            beyond: [R::ZERO; LANES],
            face: [ComplexFace::NONE; LANES],
            draws: Draws {
                tilts: [[0.0; LANES]; 2],
                choices: [[0.0; LANES]; 2],
                weights: [[0.0; LANES]; 2],
                generator: [[1; LANES]; 4],
            },
            done: [0; LANES],
            slot: [IDLE; LANES],
        };
        (0..LANES).for_each(|lane| lanes.rest(lane, problem));
        lanes
    }

    /// Parks a lane without a path in the middle of the stack, where it disturbs nobody.
    fn rest(&mut self, lane: usize, problem: &Problem<R>) {
        let middle = Ray {
            x: R::ZERO,
            y: R::ZERO,
            z: R::ONE,
            interface: problem.constants.last / 2,
            step: 1,
            met: 0,
            depth: R::ZERO,
        };
        self.set::<true>(lane, middle);
        self.slot[lane] = IDLE;
        self.limit[lane] = R::from_f64(f64::INFINITY);
        self.draws.set_generator(lane, [1 + lane as u32; 4]);
    }

    #[inline(always)]
    fn get(&self, lane: usize) -> Ray<R> {
        Ray {
            x: self.x[lane],
            y: self.y[lane],
            z: self.z[lane],
            interface: self.interface[lane],
            step: self.step[lane],
            met: self.met[lane],
            depth: self.depth[lane],
        }
    }

    #[inline(always)]
    fn set<const ABSORBS: bool>(&mut self, lane: usize, ray: Ray<R>) {
        self.x[lane] = ray.x;
        self.y[lane] = ray.y;
        self.z[lane] = ray.z;
        self.interface[lane] = ray.interface;
        self.step[lane] = ray.step;
        self.met[lane] = ray.met;
        if ABSORBS {
            self.depth[lane] = ray.depth;
        }
    }

    /// Starts path number `path` in a lane.
    #[inline(always)]
    fn start(&mut self, lane: usize, job: &Job, path: u64) {
        let (generator, spare) = job.stream.path(path);
        let ray = Ray {
            x: R::from_f64(job.sin_i),
            y: R::ZERO,
            z: R::from_f64(job.cos_i),
            interface: 0,
            step: 1,
            met: 0,
            depth: R::ZERO,
        };
        self.set::<true>(lane, ray);
        self.draws.set_generator(lane, generator.state);
        self.slot[lane] = (path - job.paths.start) as usize;
        // Tracked light: every other path is s.
        let is_s = job.light == Light::S || (job.light == Light::Tracked && path.is_multiple_of(2));
        self.polarisation[lane] = -i32::from(is_s);
        if job.absorbs {
            let budget = -libm::log((f64::from(spare) + 0.5) / 4_294_967_296.0);
            self.limit[lane] = R::from_f64(WEIGHT_DEPTH + budget);
        }
    }

    /// Moves the path of lane `from` to lane `to`.
    fn shift(&mut self, from: usize, to: usize) {
        self.set::<true>(to, self.get(from));
        self.limit[to] = self.limit[from];
        self.polarisation[to] = self.polarisation[from];
        let generator = self.draws.generator(from);
        self.draws.set_generator(to, generator.state);
        self.slot[to] = self.slot[from];
    }

    /// How the path of a lane ended.
    #[inline(always)]
    fn exit(&self, lane: usize, problem: &Problem<R>, event_cap: u32) -> Exit {
        let ray = self.get(lane);
        // A sweep of the plane may have added one crossing too many.
        let fate = if ray.met / CROSSING > event_cap {
            Fate::Truncated
        } else if ray.interface < 0 {
            match ray.met {
                CROSSING => Fate::Single,
                met if met & ENTERED == 0 => Fate::Rehit,
                _ => Fate::Interior,
            }
        } else if ray.interface > problem.constants.last {
            Fate::Transmitted
        } else if ray.depth > self.limit[lane] {
            Fate::Absorbed
        } else {
            Fate::Truncated
        };
        let depth = ray.depth.to_f64();
        let weight = if depth > 0.0 { libm::exp(-depth.min(WEIGHT_DEPTH)) } else { 1.0 };
        Exit { direction: [ray.x, ray.y, ray.z].map(|v| v.to_f64() as f32), weight: weight as f32, fate }
    }

    /// Looks up the interfaces that the rays of an explicit stack head for.
    #[inline(always)]
    pub(crate) fn look_ahead<const ABSORBS: bool, const COMPLEX: bool>(
        &mut self,
        problem: &Problem<R>,
        count: usize,
    ) {
        for lane in 0..count.min(LANES) {
            let ahead = problem.explicit::<COMPLEX>(self.interface[lane], self.step[lane]);
            self.ratio[lane] = ahead.ratio;
            if ABSORBS {
                self.here[lane] = ahead.here;
                self.beyond[lane] = ahead.beyond;
            }
            if COMPLEX {
                self.face[lane] = ahead.face;
            }
        }
    }

    /// Moves every path on by the events `FROM..TO` of the sweep; whether any path ended.
    #[inline(always)]
    pub(crate) fn meet<K: Kernel<Real = R>, const FUSED: bool, const FROM: usize, const TO: usize>(
        &mut self,
        problem: &Problem<R>,
        count: usize,
    ) -> bool {
        let constants = problem.constants;
        let mut any = 0;
        for lane in 0..count.min(LANES) {
            let mut ray = self.get(lane);
            let mut done = if FROM == 0 { 0 } else { self.done[lane] };
            for event in FROM..TO {
                // A path that ended in the first event of a sweep rests in the second.
                let rests = event > 0 && done != 0;
                (ray, done) = self.event::<K, FUSED>(event, constants, lane, ray, rests);
            }
            any |= done;
            self.done[lane] = done;
            if K::MODES.absorbs {
                self.set::<true>(lane, ray);
            } else {
                self.set::<false>(lane, ray);
            }
        }
        any != 0
    }

    /// Event number `event` of a sweep for the path of a lane: the ray after it, and −1 if the path has ended. A path that
    /// rests stays.
    #[inline(always)]
    fn event<K: Kernel<Real = R>, const FUSED: bool>(
        &self,
        event: usize,
        constants: Constants<R>,
        lane: usize,
        ray: Ray<R>,
        rests: bool,
    ) -> (Ray<R>, i32) {
        let Draws { tilts, choices, weights, .. } = &self.draws;
        let tilt = tilts[event][lane];
        let facet = if K::MODES.is_space() {
            Facet::sloped::<FUSED>(tilt, tilts[1][lane])
        } else {
            Facet::tilted::<K, FUSED>(tilt)
        };
        let ahead = if K::MODES.is_explicit() {
            let face = if K::MODES.complex { self.face[lane] } else { ComplexFace::NONE };
            Ahead { ratio: self.ratio[lane], here: self.here[lane], beyond: self.beyond[lane], face }
        } else {
            constants.repeating::<K>(ray.interface, ray.step)
        };
        let takes = |a: R| {
            !rests & (!K::MODES.visible || constants.sees::<K>(&ray, facet, tilt, a, weights[event][lane]))
        };
        let is_s = self.polarisation[lane] < 0;
        let ray = constants.meet::<K, FUSED>(ray, facet, ahead, choices[event][lane], is_s, takes);
        let absorbed = K::MODES.absorbs && ray.depth > self.limit[lane];
        (ray, -i32::from(constants.is_out(&ray) | absorbed))
    }

    /// The blocks of the first `count` lanes in which a path has ended, one bit each.
    #[inline(always)]
    pub(crate) fn ended(&self, count: usize) -> u32 {
        let blocks = self.done[..count.min(LANES)].chunks_exact(BLOCK).enumerate();
        blocks.fold(0, |blocks, (block, done)| {
            blocks | u32::from(done.iter().fold(0, |any, done| any | done) != 0) << block
        })
    }

    /// Ends the paths that have reached the cap, and says how many sweeps from now it is worth to look again: a sweep
    /// adds two crossings at most, and a new path starts from none.
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
}

/// Walks all paths of a job, one `Exit` each in path order; the number of crossings.
pub(crate) fn walk<R: Real>(problem: &Problem<R>, sweep: Sweep<R>, job: &Job, out: &mut [Exit]) -> u64 {
    let mut lanes = Lanes::idle(problem);
    let mut paths = job.paths.clone();
    let mut live = 0_usize;
    for (lane, path) in (0..LANES).zip(paths.by_ref()) {
        lanes.start(lane, job, path);
        live += 1;
    }
    let mut harvest = Harvest { problem, job, out, paths, live, crossings: 0 };
    let mut until_cut = lanes.cut(job.event_cap);
    while harvest.live > 0 {
        let count = harvest.live.next_multiple_of(BLOCK);
        let mut ended = sweep(&mut lanes, problem, count);
        until_cut -= 1;
        if until_cut == 0 {
            until_cut = lanes.cut(job.event_cap);
            ended = lanes.ended(count);
        }
        // From the last lane down, so that the lane that fills a gap has been looked at already.
        while let Some(block) = ended.checked_ilog2() {
            ended ^= 1 << block;
            harvest.block(&mut lanes, block as usize * BLOCK);
        }
    }
    harvest.crossings
}

/// What becomes of paths that have ended.
struct Harvest<'a, R> {
    problem: &'a Problem<R>,
    job: &'a Job,
    out: &'a mut [Exit],
    /// Paths that wait for a lane.
    paths: Range<u64>,
    /// Lanes that carry a path.
    live: usize,
    crossings: u64,
}

impl<R: Real> Harvest<'_, R> {
    /// Books the paths of a block of lanes that have ended, and starts others. Out of line: within the sweeps it costs them
    /// registers (2 to 4 % of the instructions of a crossing).
    #[inline(never)]
    fn block(&mut self, lanes: &mut Lanes<R>, first: usize) {
        for lane in (first..first + BLOCK).rev() {
            if lanes.done[lane] == 0 {
                continue;
            }
            if lanes.slot[lane] == IDLE {
                lanes.rest(lane, self.problem);
                continue;
            }
            self.crossings += u64::from(lanes.met[lane] / CROSSING);
            self.out[lanes.slot[lane]] = lanes.exit(lane, self.problem, self.job.event_cap);
            if let Some(path) = self.paths.next() {
                lanes.start(lane, self.job, path);
                continue;
            }
            self.live -= 1;
            lanes.shift(self.live, lane);
            lanes.rest(self.live, self.problem);
        }
    }
}
