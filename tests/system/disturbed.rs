//! The calibration of `configs/`, disturbed at seeded moments in virtual time. Its final report is true,
//! the arm stands when it should, and no result of an earlier run is overwritten by a worse one.
//!
//! `CTOS_MOMENTS=40` tries so many moments of the whole calibration; without it each disturbance is tried
//! at one moment of a shorter one.

mod cell;

use ctos::boot::End;
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use cell::{Disturbance, Ended, Job, run};

const CHASSIS: [&str; 3] = ["ws1", "cage_motion", "cage_vision"];

/// How long braking and settling may take, s.
const TO_REST_S: f64 = 2.0;

/// The moments at which something happens, s, from a seed that names the disturbance.
fn moments(name: &str, job: &Job) -> Vec<f64> {
    let seed = ctos::mix(1, &["moments", name]);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..job.moments)
        .map(|_| rng.random_range(0.5..job.moves_s))
        .collect()
}

/// Runs the job once for each moment, and checks what holds whatever happens.
fn disturbed(name: &str, what: impl Fn(f64) -> Disturbance, check: impl Fn(&Ended, f64)) {
    let job = Job::of_environment();
    for at in moments(name, &job) {
        let ended = run(&job, &what(at));
        println!("{name} at {at:.3} s: {}", ended.told());
        ended.arm_must_be_at_rest_without_power();
        ended.results_must_be_true_or_untouched();
        check(&ended, at);
    }
}

#[test]
fn undisturbed_it_succeeds_and_replaces_the_results() {
    let job = Job::of_environment();
    let ended = run(&job, &Disturbance::None);
    ended.must_succeed();
    assert!(ended.results_are_new());
    let last = ended.motions.last().unwrap().1;
    assert!(
        (last - job.moves_s).abs() < 5.0,
        "moments are drawn up to {} s, and the arm moves until {last} s",
        job.moves_s
    );
}

#[test]
fn a_chassis_that_is_killed_ends_the_app_in_its_name() {
    for chassis in CHASSIS {
        let kill = |at| Disturbance::Kill(chassis, at);
        disturbed(&format!("kill {chassis}"), kill, |ended, at| {
            assert!(ended.is_chassis_down(chassis), "{}", ended.told());
            ended.arm_must_stand(at + TO_REST_S, f64::INFINITY);
            assert!(!ended.results_are_new());
        });
    }
}

#[test]
fn a_chassis_that_is_killed_and_started_again_burns_no_position() {
    disturbed(
        "kill and start cage_vision",
        |at| Disturbance::KillAndStart("cage_vision", at),
        |ended, _| ended.must_succeed(),
    );
    // The Operator, begun anew, gives its command again.
    disturbed(
        "kill and start ws1",
        |at| Disturbance::KillAndStart("ws1", at),
        |ended, _| ended.must_succeed(),
    );
    disturbed(
        "kill and start cage_motion",
        |at| Disturbance::KillAndStart("cage_motion", at),
        |ended, _| ended.must_fail(&["lost"]),
    );
}

#[test]
fn the_calibration_goes_on_at_its_position_whenever_the_dispatcher_is_killed_and_repeats_nothing() {
    let job = Job::of_environment();
    let whole = run(&job, &Disturbance::KillDispatcher(Vec::new()));
    whole.must_succeed();
    // Moments that have nothing to do with those of the command, a third of it apart.
    for shift in 0..3 {
        let third = job.moves_s / 3.0;
        let first = 0.7 + 1.37 * f64::from(shift);
        let kills = vec![first, first + third, first + 2.0 * third];
        let ended = run(&job, &Disturbance::KillDispatcher(kills.clone()));
        println!("killed at {kills:?} s: {}", ended.told());
        ended.must_succeed();
        assert_eq!(ended.faults, kills.len());
        assert_eq!(ended.motions.len(), whole.motions.len(), "{kills:?}");
        ended.arm_must_be_at_rest_without_power();
    }
}

#[test]
fn a_chassis_that_a_person_restarts_costs_no_truth() {
    disturbed(
        "restart cage_vision",
        |at| Disturbance::Restart("cage_vision", at),
        |ended, _| ended.must_succeed(),
    );
    // With the Coordination Level the command ends.
    disturbed(
        "restart ws1",
        |at| Disturbance::Restart("ws1", at),
        |ended, _| ended.must_fail(&["chassis `ws1` was to be restarted"]),
    );
    disturbed(
        "restart cage_motion",
        |at| Disturbance::Restart("cage_motion", at),
        |ended, _| ended.must_fail(&["lost"]),
    );
}

#[test]
fn a_chassis_that_stands_still_for_a_second_is_waited_for_and_for_four_given_up() {
    for chassis in CHASSIS {
        let short = |at| Disturbance::Freeze(chassis, at, 1.0);
        disturbed(&format!("freeze {chassis}"), short, |ended, _| {
            ended.must_succeed();
        });
        let long = |at| Disturbance::Freeze(chassis, at, 4.0);
        disturbed(&format!("long freeze {chassis}"), long, |ended, at| {
            assert!(ended.is_chassis_down(chassis), "{}", ended.told());
            // It finds out when it goes on.
            ended.arm_must_stand(at + 4.0 + TO_REST_S, f64::INFINITY);
            assert!(!ended.results_are_new());
        });
    }
}

#[test]
fn a_protective_stop_that_nobody_ends_fails_the_command_and_the_arm_stands() {
    disturbed("stop", Disturbance::Stop, |ended, at| {
        ended.must_fail(&["stopped", "nobody resumed"]);
        ended.arm_must_stand(at + TO_REST_S, f64::INFINITY);
    });
}

#[test]
fn after_a_protective_stop_the_arm_stands_until_somebody_resumes_and_the_command_succeeds() {
    let stop = |at| Disturbance::StopAndResume(at, at + 10.0);
    disturbed("stop and resume", stop, |ended, at| {
        ended.must_succeed();
        ended.arm_must_stand(at + TO_REST_S, at + 10.0);
    });
}

#[test]
fn an_emergency_stop_takes_power_away_at_once_and_fails_the_command() {
    disturbed("estop", Disturbance::EmergencyStop, |ended, at| {
        ended.must_fail(&["estopped", "emergency stop was asked for"]);
        ended.arm_must_be_without_power(at + 0.1);
    });
}

#[test]
fn an_interrupt_stops_the_arm_and_then_cleans_up_while_devices_live() {
    disturbed("interrupt", Disturbance::Interrupt, |ended, at| {
        assert_eq!(ended.end, End::Interrupted);
        ended.arm_must_stand(at + TO_REST_S, f64::INFINITY);
        assert!(!ended.results_are_new());
        ended.lamp_must_be_off_before_its_task_stops(at);
    });
}

#[test]
fn an_obstacle_in_the_way_is_a_fault_and_not_pushed_against() {
    let mut met = 0;
    let job = Job::of_environment();
    let mut rng = ChaCha8Rng::seed_from_u64(ctos::mix(1, &["obstacles"]));
    for _ in 0..job.moments {
        // A post in the work volume, not where the arm stands at first.
        let angle: f64 = rng.random_range(-2.4..2.4);
        let radius = rng.random_range(0.45..0.75);
        let centre = [radius * angle.cos(), radius * angle.sin()];
        if angle.abs() < 0.4 {
            continue;
        }
        let ended = run(&job, &Disturbance::Obstacle(centre));
        println!("obstacle at {centre:?}: {}", ended.told());
        ended.arm_must_be_at_rest_without_power();
        ended.results_must_be_true_or_untouched();
        if ended.succeeded() {
            ended.must_succeed();
        } else {
            met += 1;
            ended.must_fail(&["fault", "power was taken away"]);
            assert!(ended.pushed_for_s < 0.5, "{}", ended.told());
        }
    }
    assert!(met > 0 || job.moments < 10, "no post was in the way");
}

#[test]
fn a_camera_that_fails_ends_the_command_in_its_name() {
    disturbed("camera", Disturbance::CameraLost, |ended, _| {
        ended.must_fail(&["fault", "ceiling_west", "no signal"]);
    });
}
