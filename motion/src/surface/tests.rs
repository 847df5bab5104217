//! Force adaptation on simulated contacts: lag, dead time, noise, tilt and bumps.

use super::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

struct Bench {
    stiffness: f64,
    dt: f64,
    hz: f64,
    force: f64,
    height: fn(f64) -> f64,
    lag: f64,
    dead: f64,
    start: f64,
}

/// A wiping path over a table tilted by 4 degrees about both axes with a bump of 5 mm.
fn tilted(phase: f64) -> f64 {
    let (x, y) = (0.06 * libm::cos(phase), 0.04 * libm::sin(phase));
    let bump = 0.005 * libm::exp(-((x - 0.05).powi(2) + y.powi(2)) / (2.0 * 0.025_f64.powi(2)));
    0.07 * x - 0.04 * y + bump
}

fn of_the_design_page(phase: f64) -> f64 {
    let (x, y) = (0.15 * libm::sin(phase), 0.1 * libm::sin(2.0 * phase + 0.3));
    0.02 * x - 0.03 * y + 0.01 * libm::exp(-((x - 0.1).powi(2) + (y - 0.05).powi(2)) / 0.005)
}

struct Result {
    rms: Vec<f64>,
    off: f64,
    worst_late: f64,
    stiffness: f64,
    fastest: f64,
}

fn run(bench: &Bench, config: SurfaceConfig, cycles: u32) -> Result {
    run_from(bench, SurfaceAdaptation::new(config).unwrap(), cycles).0
}

/// `cycles` of adaptation, then 4 with the feedback off, on a simulated contact: arm lag, dead time, noise.
fn run_from(bench: &Bench, mut adaptation: SurfaceAdaptation, cycles: u32) -> (Result, SurfaceAdaptation) {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let noise = Normal::new(0.0, 0.3).unwrap();
    let omega = TAU * bench.hz;
    let dead = (bench.dead / bench.dt).round() as usize;
    let mut commands = vec![(0.0, 0.0); dead + 1];
    let (mut z, mut along, mut phase) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (mut off, mut off_count, mut worst_late, mut fastest) = (0.0, 0.0, 0.0_f64, 0.0_f64);
    let mut k = 0;
    while adaptation.cycles() < cycles + 4 {
        // The hand follows the command of some time ago, with a lag, along the surface as well.
        let (old_offset, old_phase) = commands[k % (dead + 1)];
        let share = 1.0 - libm::exp(-bench.dt / bench.lag);
        z += share * (bench.start + old_offset - z);
        along += share * (old_phase - along);
        let truth = (bench.stiffness * ((bench.height)(along) - z)).max(0.0);
        let pace = if adaptation.cycles() < 3 { adaptation.pace() } else { 1.0 };
        let speed = omega * pace;
        let c = adaptation
            .step(bench.dt, phase.rem_euclid(TAU), speed, truth + noise.sample(&mut random))
            .unwrap();
        fastest = fastest.max(c.velocity.abs());
        commands[k % (dead + 1)] = (c.offset, phase);
        if adaptation.cycles() >= cycles {
            if off_count == 0.0 {
                adaptation.set_feedback(false);
                adaptation.set_learning(false);
            }
            off += (truth - bench.force).powi(2);
            off_count += 1.0;
        } else if adaptation.cycles() + 3 >= cycles {
            worst_late = worst_late.max((truth - bench.force).abs());
        }
        phase += speed * bench.dt;
        k += 1;
    }
    let result = Result {
        rms: adaptation.rms().to_vec(),
        off: (off / off_count).sqrt(),
        worst_late,
        stiffness: adaptation.stiffness(),
        fastest,
    };
    (result, adaptation)
}

#[test]
fn what_was_learned_before_holds_the_force_from_the_first_cycle_on() {
    let (stiffness, force) = (2000.0, 8.0);
    let start = tilted(0.0) - force / stiffness;
    let bench = Bench { stiffness, dt: 0.001, hz: 0.5, force, height: tilted, lag: 0.02, dead: 0.01, start };
    let (first, learned) = run_from(&bench, SurfaceAdaptation::new(SurfaceConfig::default()).unwrap(), 12);
    let known = learned.correction().clone();
    // The hand touches down elsewhere, with the tool held 5 mm higher.
    let again =
        Bench { start: start + 0.005 - known.offset(0.0), height: |phase| tilted(phase) + 0.005, ..bench };
    let config = SurfaceConfig { stiffness, ..SurfaceConfig::default() };
    let (second, _) = run_from(&again, SurfaceAdaptation::resume(config, known, 0.0).unwrap(), 4);
    println!("first {:.2} with nothing known, {:.2} with what was learned", first.rms[0], second.rms[0]);
    assert!(second.rms[0] < 0.5 * first.rms[0] && second.rms[1] < 0.85, "{:?}", second.rms);
}

#[test]
fn the_force_is_learned_and_holds_with_the_feedback_off() {
    // An orthogonal array: each three of the four factors in all their combinations.
    let drives = [(0.02, 0.01), (0.05, 0.01), (0.008, 0.004)];
    for (i, stiffness) in [500.0, 2000.0, 8000.0].into_iter().enumerate() {
        for (j, hz) in [0.3, 0.5, 0.8].into_iter().enumerate() {
            for (k, (dt, force)) in [(0.001, 8.0), (0.005, 5.0), (0.001, 15.0)].into_iter().enumerate() {
                let (lag, dead) = drives[(i + j + k) % 3];
                let start = -force / stiffness + tilted(0.0);
                let bench = Bench { stiffness, dt, hz, force, height: tilted, lag, dead, start };
                let r = run(&bench, SurfaceConfig { force, ..SurfaceConfig::default() }, 14);
                println!(
                    "k {stiffness} f {hz} dt {dt} F {force} lag {lag}: first {:.2} 4th {:.2} last {:.2} off {:.2} late {:.2} k^ {:.0} v {:.3}",
                    r.rms[0], r.rms[3], r.rms[13], r.off, r.worst_late, r.stiffness, r.fastest
                );
                let allowed = 0.25_f64.max(stiffness * 1e-4);
                assert!(r.off < allowed, "off {}", r.off);
                assert!(r.rms[13] < 0.85, "last cycle {}", r.rms[13]);
                assert!(r.worst_late < 3.5, "late {}", r.worst_late);
            }
        }
    }
}

#[test]
fn the_table_of_the_design_page() {
    for stiffness in [500.0, 2000.0, 8000.0] {
        let bench = Bench {
            stiffness,
            dt: 0.005,
            hz: 0.5,
            force: 10.0,
            height: of_the_design_page,
            lag: 1e-6,
            dead: 0.005,
            start: 0.020,
        };
        let config = SurfaceConfig { force: 10.0, delay: 0.005, ..SurfaceConfig::default() };
        let r = run(&bench, config, 16);
        println!("page k {stiffness}: {:?} off {:.3}", r.rms, r.off);
        assert!(r.off < 0.2_f64.max(stiffness * 1e-4), "{stiffness} {}", r.off);
    }
}
