//! The interfaces below interface 0 as a short program: periodic runs to double, the rest to add one by one.

use num_complex::Complex64;

use crate::Transport;

/// Longest period that is looked for.
const LONGEST_PERIOD: usize = 32;

/// A layer and the interface under it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Element {
    /// Index of the layer.
    pub(super) above: Complex64,
    /// Index of the medium under it.
    pub(super) below: Complex64,
    /// Optical depth of the layer.
    pub(super) depth: f64,
}

/// `count` repetitions of the elements `start..start + period`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Run {
    pub(super) start: usize,
    pub(super) period: usize,
    pub(super) count: usize,
}

impl Run {
    /// Star products that the run costs (adding it to what is below included).
    pub(super) fn products(&self) -> usize {
        let doublings = self.count.ilog2() as usize + self.count.count_ones() as usize - 1;
        self.period + doublings
    }
}

/// Layers 1…L with the interface under each, top down.
pub(super) fn elements(transport: &Transport) -> Vec<Element> {
    transport
        .optical_depths
        .iter()
        .enumerate()
        .map(|(at, &depth)| Element { above: transport.index(at + 1), below: transport.index(at + 2), depth })
        .collect()
}

/// Splits the elements into runs, top down: greedy, the longest repetition first, short periods preferred.
pub(super) fn runs(elements: &[Element]) -> Vec<Run> {
    let mut runs = Vec::new();
    let mut start = 0;
    while start < elements.len() {
        let run = longest_run(elements, start);
        start += run.period * run.count;
        runs.push(run);
    }
    runs
}

fn longest_run(elements: &[Element], start: usize) -> Run {
    let rest = &elements[start..];
    let mut best = Run { start, period: 1, count: 1 };
    for period in 1..=LONGEST_PERIOD.min(rest.len() / 2) {
        let same = rest.iter().zip(&rest[period..]).take_while(|(a, b)| a == b).count();
        let count = 1 + same / period;
        if count > 1 && period * count > best.period * best.count {
            best = Run { start, period, count };
        }
        // A run this long pays for itself; longer periods would only cost.
        if best.count > 3 {
            break;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_alternating_stack_is_one_run_and_at_most_one_interface() {
        let even = Transport::alternating(500, 1.53, 1.43, 1.53, 0.03);
        assert_eq!(runs(&elements(&even)), [Run { start: 0, period: 2, count: 250 }]);
        let odd = Transport::alternating(501, 1.53, 1.43, 1.0, 0.03);
        let last = Run { start: 500, period: 1, count: 1 };
        assert_eq!(runs(&elements(&odd)), [Run { start: 0, period: 2, count: 250 }, last]);
    }

    #[test]
    fn runs_cover_an_aperiodic_stack_once() {
        let mut transport = Transport::alternating(41, 1.5, 1.4, 1.2, 0.03);
        transport.optical_depths[17] = 0.1;
        let elements = elements(&transport);
        let covered: usize = runs(&elements).iter().map(|run| run.period * run.count).sum();
        assert_eq!(covered, 41);
    }

    #[test]
    fn products_grow_with_the_logarithm_of_the_count() {
        assert_eq!(Run { start: 0, period: 2, count: 250 }.products(), 14);
        assert_eq!(Run { start: 0, period: 2, count: 50_000 }.products(), 22);
    }
}
