//! Drivers that fall silent or fail again: what is told of them.

use super::*;

#[test]
fn a_joint_that_seems_not_to_follow_because_nothing_new_is_read_of_it_tells_whose_silence_that_is()
{
    // At once far away, and for long a little off.
    for (speed, ticks) in [(1.0, 2..22), (0.2, 22..60)] {
        let mut rig = Rig::pid();
        rig.release();
        let segment = rig.plan(speed);
        rig.start(segment);
        (0..40).for_each(|_| rig.servo.tick(0));
        rig.knobs.fault.store(5, Ordering::Relaxed);
        let mut silent = 0;
        while rig.port.status().fault.is_none() {
            rig.servo.tick(0);
            silent += 1;
        }
        let status = rig.port.status();
        assert_eq!(
            (status.power, status.fault),
            (Power::Off, Some(Fault::Driver))
        );
        assert!(ticks.contains(&silent), "{silent}");
        let told = rig.port.driver_error().unwrap().to_string();
        let expected = format!("silent for {:?}", Duration::from_micros(4500) * silent);
        assert!(told.contains(&expected), "{told}");
    }
    // An arm that is held fast is held fast, whatever was not heard at last.
    let mut rig = Rig::pid();
    rig.release();
    let segment = rig.plan(0.2);
    rig.knobs.fault.store(4, Ordering::Relaxed);
    rig.start(segment);
    while rig.servo.astray[0] < 20 {
        rig.servo.tick(0);
    }
    rig.knobs.fault.store(5, Ordering::Relaxed);
    while rig.port.status().fault.is_none() {
        rig.servo.tick(0);
    }
    let fault = rig.port.status().fault.unwrap();
    assert!(
        matches!(fault, Fault::NotFollowing { joint: 1, .. }),
        "{fault}"
    );
}

#[test]
fn a_driver_that_fails_again_is_told_with_its_new_reason_and_not_with_what_the_fault_before_has_left()
 {
    let mut rig = Rig::pid();
    rig.release();
    rig.knobs.fault.store(1, Ordering::Relaxed);
    rig.servo.tick(0);
    let told = |rig: &Rig| rig.port.driver_error().unwrap().to_string();
    assert!(told(&rig).contains("cable out"));
    // It goes on failing, and nobody looks any more.
    (0..10).for_each(|_| rig.servo.tick(0));
    rig.knobs.fault.store(0, Ordering::Relaxed);
    rig.order(ServoCommand::Reset);
    rig.release();
    let segment = rig.plan(1.0);
    rig.start(segment);
    (0..40).for_each(|_| rig.servo.tick(0));
    rig.knobs.fault.store(5, Ordering::Relaxed);
    while rig.port.status().fault.is_none() {
        rig.servo.tick(0);
    }
    assert!(told(&rig).contains("silent for"), "{}", told(&rig));
}
