//! Settling of the oscillator with and without an estimated start, and the allowed settings.

use super::*;

fn run(settings: Oscillator) -> ExperimentResult {
    settings.run().unwrap()
}

fn figure(outcome: &ExperimentResult, name: &str) -> f64 {
    outcome.figures[name].as_f64().unwrap_or(f64::NAN)
}

#[test]
fn with_an_estimate_it_settles_where_the_bare_one_does_not() {
    for frequency in [0.3, 3.0] {
        let settings = Oscillator { frequency, seconds: 30.0, ..Oscillator::default() };
        let estimated = run(settings.clone());
        assert!(figure(&estimated, "settle_s") < 8.0 / frequency);
        assert!(figure(&estimated, "error") < 1e-3 && figure(&estimated, "ripple") < 0.01);
        let bare = run(Oscillator { estimate: false, ..settings });
        assert!(figure(&bare, "settle_s").is_nan());
    }
}

#[test]
fn a_step_has_two_times_and_a_plane_figure_two_coordinates() {
    let step = run(Oscillator { signal: Signal::Step, ..Oscillator::default() });
    assert!(figure(&step, "settle_s") < 8.0 && figure(&step, "settle_after_step_s") < 5.0);
    let plane = run(Oscillator { signal: Signal::Plane, seconds: 20.0, ..Oscillator::default() });
    assert!(figure(&plane, "settle_periods") < 8.0);
    assert!(figure(&plane, "settle_after_step_s").is_nan());
    assert!(matches!(
        Oscillator { dt: 0.0, ..Oscillator::default() }.run(),
        Err(ExperimentError::Setting { .. })
    ));
}
