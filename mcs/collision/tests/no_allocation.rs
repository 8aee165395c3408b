//! The tick of 18 joints with limits, guards of every kind and collision detection never allocates.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

mod rig;

use mcs::servo::MotionPhase;

#[test]
fn no_tick_of_18_joints_with_limits_guards_and_collision_detection_allocates() {
    for limit_jerk in [false, true] {
        let (mut servo, port) = rig::servo(rig::RECIPES.len(), limit_jerk);
        let (mut allocations, mut ticks) = (0, 0);
        while servo.status().motion.phase == MotionPhase::Moving {
            allocations += allocation_counter::measure(|| servo.tick(0)).count_total;
            ticks += 1;
        }
        assert_eq!(allocations, 0, "limits of jerk: {limit_jerk}");
        // All guards were asked to the end: none of them found anything.
        let status = port.status();
        assert_eq!((status.guard, status.fault), (None, None));
        assert_eq!(status.motion.phase, MotionPhase::Settling);
        assert!(ticks > 200, "{ticks}");
    }
}
