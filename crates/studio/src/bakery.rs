//! One bake at a time; a later order overtakes earlier ones.

use crate::errors;
use bake_brdf::bake::{self, BakeError, Observer, Request};
use bake_brdf::effects::{Effect, Setting, View};
use bake_brdf::options::{Options, SolverChoice, Target};
use bake_brdf::recipe::{AzimuthMode, Look, Recipe};
use lut_io::table::Table;
use pearl_bsdf::{Array, BsdfError, Prepared};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use tokio::sync::oneshot;

/// Incidences of a coarse table, degrees (near the horizon lobes change most), and its cells; in space for a forecast only.
const COARSE_DEG: [f64; 12] = [0.0, 20.0, 37.0, 52.0, 64.0, 72.0, 78.0, 82.0, 85.0, 87.0, 88.5, 89.6];
const COARSE_CELLS: [usize; 2] = [48, 1];
const SPACE_CELLS: [usize; 2] = [48, 24];
/// Per cent.
const COARSE_ACCURACY: f64 = 5.0;
const FINE_ACCURACY: f64 = 1.0;
/// Longest bake, seconds by the forecast.
const COARSE_SECONDS: f64 = 5.0;
const FINE_SECONDS: f64 = 60.0;

/// How well.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Quality {
    /// In the plane, by doubling, one wavelength of the lobe, one thickness, RGB alone: to be seen at once.
    Coarse,
    /// To 1 %.
    Fine,
}

/// What is to be baked.
#[derive(Clone, Debug)]
pub(crate) struct Order {
    pub(crate) recipe: Recipe,
    pub(crate) quality: Quality,
}

/// What came of it.
#[derive(Clone, Debug)]
pub(crate) struct Baked {
    pub(crate) table: Arc<Table>,
    pub(crate) prepared: Arc<Prepared>,
    /// Error bars; none of a coarse one.
    pub(crate) errors: Vec<Array>,
    /// Seconds of its parts, one after the other.
    pub(crate) parts: Vec<(&'static str, f64)>,
}

/// Why nothing came of it.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Unbaked {
    /// A later order came, or the server ends.
    Overtaken,
    /// One line.
    Refused(String),
}

impl From<BakeError> for Unbaked {
    fn from(error: BakeError) -> Self {
        match error {
            BakeError::Interrupted => Self::Overtaken,
            BakeError::Doubling(why) => {
                Self::Refused(format!("recipe: cannot be baked here: {why}; `bake-brdf` may walk it"))
            }
            error => Self::Refused(error.to_string()),
        }
    }
}

type Answer = Result<Baked, Unbaked>;
type Reply = oneshot::Sender<Answer>;

/// A thread that bakes.
pub(crate) struct Bakery {
    counter: Arc<Counter>,
    oven: Option<std::thread::JoinHandle<()>>,
}

#[derive(Default)]
struct Counter {
    orders: Mutex<Orders>,
    changed: Condvar,
}

#[derive(Default)]
struct Orders {
    next: Option<(Order, Reply)>,
    /// Whoever waits for the bake that is in the oven.
    waiting: Option<Reply>,
    stop: Arc<AtomicBool>,
    closed: bool,
}

impl Bakery {
    pub(crate) fn open(threads: Option<rayon::ThreadPool>) -> std::io::Result<Self> {
        let counter = Arc::<Counter>::default();
        let work = {
            let counter = Arc::clone(&counter);
            move || match threads {
                Some(pool) => counter.work(|order, stop| pool.install(|| bake(order, stop))),
                None => counter.work(bake),
            }
        };
        let oven = std::thread::Builder::new().name("bakery".to_owned()).spawn(work)?;
        Ok(Self { counter, oven: Some(oven) })
    }

    /// Hands in an order; earlier ones get [`Unbaked::Overtaken`].
    pub(crate) fn order(&self, order: Order) -> oneshot::Receiver<Answer> {
        let (reply, answer) = oneshot::channel();
        let mut orders = self.counter.orders();
        orders.overtake();
        orders.next = Some((order, reply));
        self.counter.changed.notify_one();
        answer
    }
}

impl Drop for Bakery {
    fn drop(&mut self) {
        let mut orders = self.counter.orders();
        orders.closed = true;
        orders.overtake();
        drop(orders);
        self.counter.changed.notify_one();
        // A bake ends at its next look at the flag. What it panics with was said already.
        let _ = self.oven.take().map(std::thread::JoinHandle::join);
    }
}

impl Orders {
    fn overtake(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for reply in self.waiting.take().into_iter().chain(self.next.take().map(|(_, reply)| reply)) {
            // Whoever waited may be gone.
            let _ = reply.send(Err(Unbaked::Overtaken));
        }
    }
}

impl Counter {
    /// Each change of the orders is whole.
    fn orders(&self) -> MutexGuard<'_, Orders> {
        self.orders.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn work(&self, bake: impl Fn(&Order, &AtomicBool) -> Answer) {
        while let Some((order, stop)) = self.take() {
            let answer = bake(&order, &stop);
            if let Some(reply) = self.orders().waiting.take_if(|_| !stop.load(Ordering::Relaxed)) {
                let _ = reply.send(answer);
            }
        }
    }

    /// The next order, once there is one; none where the bakery closes.
    fn take(&self) -> Option<(Order, Arc<AtomicBool>)> {
        let mut orders = self.orders();
        loop {
            if orders.closed {
                return None;
            }
            if let Some((order, reply)) = orders.next.take() {
                orders.waiting = Some(reply);
                orders.stop = Arc::default();
                return Some((order, Arc::clone(&orders.stop)));
            }
            orders = self.changed.wait(orders).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// Bakes and prepares.
pub(crate) fn bake(order: &Order, stop: &AtomicBool) -> Answer {
    let mut clock = Clock::start();
    let go_on = || if stop.load(Ordering::Relaxed) { Err(Unbaked::Overtaken) } else { Ok(()) };
    let request = request(order, stop)?;
    clock.stop("plan");
    go_on()?;
    let table = Arc::new(bake::bake(&request, &Observer { stop, ..Observer::idle() })?);
    clock.stop("bake");
    go_on()?;
    let prepared = Prepared::unless(stop, Arc::clone(&table), order.quality == Quality::Fine);
    let prepared = Arc::new(prepared.map_err(|error| match error {
        BsdfError::Stopped => Unbaked::Overtaken,
        error => Unbaked::Refused(error.to_string()),
    })?);
    let errors = match order.quality {
        Quality::Coarse => Vec::new(),
        Quality::Fine => errors::arrays(&table).into(),
    };
    clock.stop("prepare");
    Ok(Baked { table, prepared, errors, parts: clock.parts })
}

/// Measures parts of a work.
pub(crate) struct Clock {
    since: Instant,
    pub(crate) parts: Vec<(&'static str, f64)>,
}

impl Clock {
    pub(crate) fn start() -> Self {
        Self { since: Instant::now(), parts: Vec::new() }
    }

    /// A part ends, and the next begins.
    pub(crate) fn stop(&mut self, part: &'static str) {
        self.parts.push((part, self.since.elapsed().as_secs_f64()));
        self.since = Instant::now();
    }
}

/// A recipe's pearl as a page shows it, with its controls within reach: a table holds the colours that they mix in.
fn controlled(look: &Look) -> View {
    let control = || "a control".to_owned();
    let within = |value: f64| Setting::new(value.clamp(0.5, 1.0), control());
    View {
        depth: Setting::new(0.5, control()),
        brightness: within(look.brightness),
        coherence: within(look.coherence),
        body: Setting::new(None, control()),
        ..View::of_look(look)
    }
}

/// The request of an order that does not take too long.
fn request(order: &Order, stop: &AtomicBool) -> Result<Request, BakeError> {
    let coarse = Options {
        azimuth: Some(AzimuthMode::Decay),
        incident_deg: Some(COARSE_DEG.to_vec()),
        cells: Some(COARSE_CELLS),
        solver: Some(SolverChoice::Doubling),
        target: Target::AccuracyPercent(COARSE_ACCURACY),
        ..Options::default()
    };
    let (options, most) = match order.quality {
        Quality::Coarse => (coarse.clone(), COARSE_SECONDS),
        Quality::Fine => {
            let options = Options { target: Target::AccuracyPercent(FINE_ACCURACY), ..Options::default() };
            // The walk's time is known after a pilot alone, which may take long itself.
            (Options { solver: Some(SolverChoice::Doubling), ..options }, FINE_SECONDS)
        }
    };
    let (recipe, decisions) = options.decide(order.recipe.clone(), &controlled(&order.recipe.look))?;
    let mut effects = decisions.set();
    if order.quality == Quality::Coarse {
        effects = effects.without(Effect::Dispersion).without(Effect::Thickness);
    }
    // Placing rows and cells takes its time, too: first one with rows and cells that are given.
    let cells = match recipe.azimuth.mode {
        AzimuthMode::Decay => COARSE_CELLS,
        AzimuthMode::Space => SPACE_CELLS,
    };
    let placed = Options { incident_deg: coarse.incident_deg, cells: Some(cells), ..options.clone() };
    let placed = Request::of_unless(stop, recipe.clone(), effects, placed)?;
    let bands = placed.bands_unless(stop)?;
    let observer = Observer { stop, ..Observer::idle() };
    let seconds = bake::forecast(&placed, &bands, SolverChoice::Doubling, &observer)?.seconds;
    if seconds > most {
        let percent = if order.quality == Quality::Coarse { COARSE_ACCURACY } else { FINE_ACCURACY };
        return Err(BakeError::Input(format!(
            "recipe: would take about {seconds:.0} s to {percent} %, expected at most {most:.0} s here; `bake-brdf` takes the time that it needs"
        )));
    }
    if order.quality == Quality::Coarse {
        Ok(placed)
    } else {
        Request::of_unless(stop, recipe, effects, options)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order(text: &str, quality: Quality) -> Order {
        Order { recipe: Recipe::from_json(text).unwrap(), quality }
    }

    #[test]
    fn a_later_order_overtakes_and_the_last_is_baked() {
        let bakery = Bakery::open(None).unwrap();
        let orders = (0..4).map(|_| bakery.order(order(r#"{"stack":{"layers":500}}"#, Quality::Fine)));
        let answers: Vec<_> = orders.collect();
        let last = bakery.order(order(r#"{"stack":{"layers":4}}"#, Quality::Coarse)).blocking_recv().unwrap();
        assert_eq!(last.unwrap().table.meta().recipe["stack"]["layers"], 4);
        for answer in answers {
            assert!(matches!(answer.blocking_recv(), Ok(Err(Unbaked::Overtaken))));
        }
    }

    #[test]
    fn a_coarse_bake_is_near_the_fine_one() {
        let recipe = r#"{"stack":{"layers":60},"look":{"depth":0.5,"coherence":0.5}}"#;
        let [coarse, fine] = [Quality::Coarse, Quality::Fine].map(|quality| {
            let baked = bake(&order(recipe, quality), &AtomicBool::new(false)).unwrap();
            let look = baked.prepared.look();
            pearl_bsdf::PearlBsdf::new(baked.prepared, look).unwrap()
        });
        for degrees in [0.0, 30.0, 60.0, 80.0] {
            let [a, b] = [&coarse, &fine].map(|bsdf| bsdf.directional_albedo_seen(f64::to_radians(degrees)));
            for (a, b) in a.as_flattened().iter().zip(b.as_flattened()) {
                assert!((a - b).abs() < 0.02, "{degrees}: {a} {b}");
            }
        }
    }

    #[test]
    fn a_space_table_is_baked_fine() {
        let space = r#"{"stack":{"layers":4},"facets":{"slope_sd_deg":8},"azimuth":{"mode":"space"},"look":{"depth":0,"coherence":0}}"#;
        let [coarse, fine] = [Quality::Coarse, Quality::Fine]
            .map(|quality| bake(&order(space, quality), &AtomicBool::new(false)).unwrap());
        let modes = [coarse, fine].map(|baked| baked.table.meta().exit_axis.rows_per_incidence() > 1);
        assert_eq!(modes, [false, true]);
    }

    #[test]
    fn a_recipe_that_would_bake_for_minutes_is_refused_in_one_line() {
        let slow = r#"{"stack":{"layers":100000},"facets":{"slope_sd_deg":0.05},"azimuth":{"mode":"space"}}"#;
        let started = Instant::now();
        let found = bake(&order(slow, Quality::Fine), &AtomicBool::new(false)).unwrap_err();
        assert!(
            matches!(&found, Unbaked::Refused(line) if line.starts_with("recipe: ") && !line.contains('\n')),
            "{found:?}"
        );
        assert!(started.elapsed().as_secs_f64() < 20.0);
    }
}
