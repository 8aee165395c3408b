//! Laws that change while the servo runs.

use super::*;
use crate::control::{CartesianImpedance, CartesianImpedanceArgs, ComputedTorque, JointImpedance};
use crate::model::{DynamicsOptions, Model};

/// An arm that is a tenth heavier than the laws think, so that each holds it with torques of its own.
fn heavy_rig(name: &str, start: &[f64]) -> (Servo, ServoPort, Arc<Model>) {
    let model = Arc::new(built_in_arm(name));
    let heavy = built_in_arm(name).falsified(|body, _| body.mass *= 1.1);
    let arm = TestArm::new(heavy, start, false, &Arc::default());
    let law = PidGravity::new(Arc::clone(&model), 8.0, 1.0);
    // A soft law lets the weight that it does not know pull the arm away.
    let wide = Distances {
        turning: 0.3,
        sliding: 0.3,
    };
    let config = ServoConfig {
        following_error: wide,
        following_window: wide,
        ..ServoConfig::default()
    };
    let (servo, port) =
        Servo::new(Arc::clone(&model), Box::new(arm), Box::new(law), config).unwrap();
    (servo, port, model)
}

#[test]
fn a_law_that_changes_leaves_no_step_in_the_torques() {
    let on_carts = [&[0.2, 0.1, 0.05], &START[..]].concat();
    for (name, start) in [("puma560", &START[..]), ("testbed9", &on_carts)] {
        let (mut servo, port, model) = heavy_rig(name, start);
        port.order(ServoCommand::PowerOn).unwrap();
        port.order(ServoCommand::ReleaseBrakes).unwrap();
        // Until the integral carries what is not in the model.
        (0..600).for_each(|_| servo.tick(0));
        let stiffness = JointImpedance::of_bandwidth(&model, 5.0);
        let period = ServoConfig::default().period;
        let cartesian = CartesianImpedanceArgs::default();
        let computed = || {
            let options = DynamicsOptions::WITH_ROTORS;
            ComputedTorque::new(Arc::clone(&model), 8.0, 1.0, options)
        };
        let others: [Box<dyn ControlLaw>; 5] = [
            Box::new(computed()),
            Box::new(JointImpedance::new(Arc::clone(&model), stiffness, 1.0, period).unwrap()),
            Box::new(CartesianImpedance::new(Arc::clone(&model), cartesian, 1.0).unwrap()),
            Box::new(computed()),
            Box::new(PidGravity::new(Arc::clone(&model), 8.0, 1.0)),
        ];
        for (number, law) in others.into_iter().enumerate() {
            port.change_law(law).unwrap();
            let mut before = servo.status().torque;
            for tick in 0..400 {
                servo.tick(0);
                let now = servo.status().torque;
                for joint in 0..model.dof() {
                    let step = (now[joint] - before[joint]).abs();
                    let at = format!("{name}, law {number}, tick {tick}, joint {}", joint + 1);
                    let share = step / model.joints()[joint].limits.torque;
                    assert!(share < 0.01, "{at}: {share} of what the drive can");
                }
                before = now;
            }
            assert_eq!(servo.status().fault, None, "{name}, law {number}");
        }
    }
}

#[test]
fn a_law_that_is_changed_under_power_off_is_the_one_that_holds_the_arm() {
    let (mut servo, port, model) = heavy_rig("puma560", &START);
    let stiffness = vec![200.0; 6];
    let period = ServoConfig::default().period;
    let law = JointImpedance::new(Arc::clone(&model), stiffness, 1.0, period).unwrap();
    port.change_law(Box::new(law)).unwrap();
    servo.tick(0);
    port.order(ServoCommand::PowerOn).unwrap();
    port.order(ServoCommand::ReleaseBrakes).unwrap();
    (0..1000).for_each(|_| servo.tick(0));
    assert_eq!(servo.status().fault, None);
    // It has no integral: the weight that the model lacks moves the soft joint.
    let off = (servo.status().setpoint[1] - servo.status().position[1]).abs();
    assert!(off > 0.008, "{off}");
}

#[test]
fn laws_that_wait_are_bounded_and_none_is_freed_in_a_tick() {
    let (mut servo, port, model) = heavy_rig("puma560", &START);
    let law = || Box::new(PidGravity::new(Arc::clone(&model), 8.0, 1.0));
    let taken = (0..100)
        .take_while(|_| port.change_law(law()).is_ok())
        .count();
    assert!((1..10).contains(&taken), "{taken}");
    servo.tick(0);
    port.change_law(law()).unwrap();
}
