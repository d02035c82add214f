//! Lanes of paths for the kernels of this example: sweep, harvest, refill.
//!
//! Nothing here knows an effect: what a kernel keeps of a path, and what it draws for it, are numbers to this module.

use std::ops::Range;

use transport::walk::Exit;

use super::draws::{Generator, Stream};
use super::stack::Stack;

const LANES: usize = 128;
const BLOCK: usize = 16;
const IDLE: usize = usize::MAX;
pub(crate) const CROSSING: u32 = 4;
pub(crate) const ENTERED: u32 = 2;

/// A path on its way, mirrored so that it always travels towards +z.
#[derive(Clone, Copy)]
pub(crate) struct Ray<const N: usize> {
    /// Direction, and what else a kernel keeps of a path.
    pub(crate) numbers: [f32; N],
    pub(crate) interface: i32,
    pub(crate) step: i32,
    pub(crate) met: u32,
}

/// A kernel that keeps N numbers of a path and draws M for a sweep.
pub(crate) trait Kernel<const N: usize, const M: usize>: Copy {
    /// Events of a sweep: two share a pair of deviates in the plane.
    const EVENTS: usize;
    /// The numbers of a lane without a path.
    const RESTING: [f32; N];
    fn stack(&self) -> &Stack;
    /// The numbers of a path that starts at sine and cosine of its incidence; `spare` are 32 random bits of its own.
    fn start(incidence: [f32; 2], path: u64, spare: u32) -> [f32; N];
    fn draw(&self, generator: &mut Generator) -> [f32; M];
    /// An event of a sweep; a ray that rests stays as it is.
    fn meet(&self, ray: Ray<N>, drawn: &[f32; M], event: usize, rests: bool) -> Ray<N>;
    #[inline(always)]
    fn has_ended(&self, ray: &Ray<N>) -> bool {
        self.stack().is_out(ray)
    }
    fn exit(&self, ray: &Ray<N>) -> Exit;
}

struct Lanes<const N: usize, const M: usize> {
    numbers: [[f32; LANES]; N],
    interface: [i32; LANES],
    step: [i32; LANES],
    met: [u32; LANES],
    drawn: [[f32; LANES]; M],
    generator: [[u32; LANES]; 4],
    done: [i32; LANES],
    slot: [usize; LANES],
}

#[inline(always)]
fn column<T: Copy + Default, const N: usize>(rows: &[[T; LANES]; N], lane: usize) -> [T; N] {
    let mut values = [T::default(); N];
    for (value, row) in values.iter_mut().zip(rows) {
        *value = row[lane];
    }
    values
}

#[inline(always)]
fn set_column<T: Copy, const N: usize>(rows: &mut [[T; LANES]; N], lane: usize, values: [T; N]) {
    for (row, value) in rows.iter_mut().zip(values) {
        row[lane] = value;
    }
}

impl<const N: usize, const M: usize> Lanes<N, M> {
    fn idle<K: Kernel<N, M>>(kernel: &K) -> Self {
        let mut lanes = Self {
            numbers: [[0.0; LANES]; N],
            interface: [0; LANES],
            step: [1; LANES],
            met: [0; LANES],
            drawn: [[0.0; LANES]; M],
            generator: [[1; LANES]; 4],
            done: [0; LANES],
            slot: [IDLE; LANES],
        };
        (0..LANES).for_each(|lane| lanes.rest(lane, kernel));
        lanes
    }

    fn rest<K: Kernel<N, M>>(&mut self, lane: usize, kernel: &K) {
        self.set(lane, Ray { numbers: K::RESTING, interface: kernel.stack().last / 2, step: 1, met: 0 });
        self.slot[lane] = IDLE;
        set_column(&mut self.generator, lane, [1 + lane as u32; 4]);
    }

    #[inline(always)]
    fn get(&self, lane: usize) -> Ray<N> {
        Ray {
            numbers: column(&self.numbers, lane),
            interface: self.interface[lane],
            step: self.step[lane],
            met: self.met[lane],
        }
    }

    #[inline(always)]
    fn set(&mut self, lane: usize, ray: Ray<N>) {
        set_column(&mut self.numbers, lane, ray.numbers);
        self.interface[lane] = ray.interface;
        self.step[lane] = ray.step;
        self.met[lane] = ray.met;
    }

    #[inline(always)]
    fn start<K: Kernel<N, M>>(&mut self, lane: usize, paths: &Paths, path: u64) {
        let (generator, spare) = paths.stream.path(path);
        let numbers = K::start(paths.incidence, path, spare);
        self.set(lane, Ray { numbers, interface: 0, step: 1, met: 0 });
        set_column(&mut self.generator, lane, generator);
        self.slot[lane] = (path - paths.first) as usize;
    }

    fn shift(&mut self, from: usize, to: usize) {
        self.set(to, self.get(from));
        let generator = column(&self.generator, from);
        set_column(&mut self.generator, to, generator);
        self.slot[to] = self.slot[from];
    }

    #[inline(always)]
    fn sweep<K: Kernel<N, M>>(&mut self, kernel: K, count: usize) -> bool {
        let count = count.min(LANES);
        for lane in 0..count {
            let mut generator = column(&self.generator, lane);
            set_column(&mut self.drawn, lane, kernel.draw(&mut generator));
            set_column(&mut self.generator, lane, generator);
        }
        let mut any = 0;
        for lane in 0..count {
            let mut ray = self.get(lane);
            let drawn = column(&self.drawn, lane);
            let mut done = 0;
            for event in 0..K::EVENTS {
                // A path that ended in the first event of a sweep rests in the second.
                let rests = event == 1 && done != 0;
                ray = kernel.meet(ray, &drawn, event, rests);
                done = -i32::from(kernel.has_ended(&ray));
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
}

/// The paths of a call.
struct Paths {
    stream: Stream,
    incidence: [f32; 2],
    first: u64,
}

/// Walks numbered paths of an incidence (radians); the number of crossings.
#[inline(always)]
pub(crate) fn walk<K: Kernel<N, M>, const N: usize, const M: usize>(
    kernel: &K,
    theta_i: f64,
    seed: u64,
    numbers: Range<u64>,
    out: &mut [Exit],
) -> u64 {
    let paths = Paths {
        stream: Stream::new(seed, theta_i),
        incidence: [theta_i.sin() as f32, theta_i.cos() as f32],
        first: numbers.start,
    };
    let event_cap = u32::MAX / CROSSING - 1;
    let mut lanes = Lanes::idle(kernel);
    let mut waiting = numbers;
    let mut live = 0_usize;
    for (lane, path) in (0..LANES).zip(waiting.by_ref()) {
        lanes.start::<K>(lane, &paths, path);
        live += 1;
    }
    let mut harvest = Harvest { kernel, paths, waiting, live, crossings: 0, out };
    let mut until_cut = lanes.cut(event_cap);
    while harvest.live > 0 {
        let count = harvest.live.next_multiple_of(BLOCK);
        let mut any = lanes.sweep(*kernel, count);
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

struct Harvest<'a, K> {
    kernel: &'a K,
    paths: Paths,
    /// Paths that wait for a lane.
    waiting: Range<u64>,
    live: usize,
    crossings: u64,
    out: &'a mut [Exit],
}

impl<K> Harvest<'_, K> {
    #[inline(never)]
    fn block<const N: usize, const M: usize>(&mut self, lanes: &mut Lanes<N, M>, first: usize)
    where
        K: Kernel<N, M>,
    {
        for lane in (first..first + BLOCK).rev() {
            if lanes.done[lane] == 0 {
                continue;
            }
            if lanes.slot[lane] == IDLE {
                lanes.rest(lane, self.kernel);
                continue;
            }
            self.crossings += u64::from(lanes.met[lane] / CROSSING);
            self.out[lanes.slot[lane]] = self.kernel.exit(&lanes.get(lane));
            if let Some(path) = self.waiting.next() {
                lanes.start::<K>(lane, &self.paths, path);
                continue;
            }
            self.live -= 1;
            lanes.shift(self.live, lane);
            lanes.rest(self.live, self.kernel);
        }
    }
}
