//! Errors of the library as the tool's: its options become flags.

use bake_brdf::bake::BakeError;
use bake_brdf::options::OptionError;
use bake_brdf::spectra::SpectraError;
use terminal::Stop;

/// Why there is no table.
pub(crate) fn refuse(error: impl Into<BakeError>) -> Stop {
    match error.into() {
        error @ BakeError::Interrupted => Stop::failure(error),
        BakeError::Option(OptionError { field, why }) => {
            Stop::BadInput(format!("--{}: {why}", field.replace('_', "-")))
        }
        // These lines begin with the option at fault.
        error @ (BakeError::Effects(_)
        | BakeError::Spectra(SpectraError::Required { .. })
        | BakeError::Doubling(_)) => Stop::BadInput(format!("--{error}")),
        error => Stop::bad_input(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bake_brdf::bake::{Bands, Request, doubling};
    use bake_brdf::options::{Options, Sides, SolverChoice, Target};
    use bake_brdf::recipe::Recipe;

    #[test]
    fn options_at_fault_are_named_as_flags() {
        let line = |options: Options| {
            let doubled = Request::new(Recipe::default(), options)
                .and_then(|request| doubling(&request, &Bands::own(&request.recipe)));
            let refused = doubled.unwrap_err();
            let Stop::BadInput(line) = refuse(refused) else { panic!("not bad input") };
            line
        };
        let default = Options::default;
        for (options, start) in [
            (Options { incident_deg: Some(vec![91.0]), ..default() }, "--incident-deg: 91 "),
            (Options { target: Target::AccuracyPercent(0.0), ..default() }, "--accuracy: 0 "),
            (Options { target: Target::Paths(9), ..default() }, "--solver: doubling "),
            (Options { event_cap: 0, ..default() }, "--event-cap: 0 "),
            (Options { sides: Sides::Both, solver: Some(SolverChoice::Walk), ..default() }, "--both-sides: "),
        ] {
            let line = line(options);
            assert!(line.starts_with(start) && line.contains("expected"), "{line}");
        }
    }
}
