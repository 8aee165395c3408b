//! What service objects ask an arm for, and from where they count.

use super::*;

#[test]
fn an_object_that_asks_an_unknown_manipulator_is_told_of_those_that_there_are() {
    text_of(|cx, _, _| {
        Box::pin(async move {
            for (class, request) in [
                ("pino", ""),
                ("pino", "estop"),
                ("mvpos", "by FMSG 6 0 0 0 0 0 0"),
                ("mvpos", "where"),
                ("slots", ""),
                ("setpoint", "state"),
                ("torque", "acquire"),
                ("wspc", "list"),
            ] {
                told(&cx, &format!("{class}.msc CTRL -client middle")).await?;
                let reply = told(&cx, &format!("{class}.msc EXEC {request}")).await?;
                let text = &reply.reports.last().ok_or("nothing was said")?.text;
                let expected = format!(
                    "`{class}.msc` asks the manipulator `middle`, and this app has none of that name: it has mcs; did you mean `mcs`?"
                );
                assert!(!reply.is_ok() && text.starts_with(&expected), "{text}");
            }
            let reply = told(&cx, "wspc.msc EXEC 'for midle'").await?;
            let text = &reply.reports.last().ok_or("nothing was said")?.text;
            assert!(text.contains("asks the manipulator `midle`"), "{text}");
            Ok(String::new())
        })
    });
}

#[test]
fn motions_on_from_where_the_arm_shall_be_add_up_also_after_an_emergency_stop() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            told(&cx, "mvpos CTRL -keep on -speed 1").await?;
            told(&cx, "mvpos EXEC by FMSG 6 0.1 0.1 0.1 0 0 0").await?;
            asked(&cx, &mcs, EmergencyStop {}).await?;
            done(&cx, &mcs, Reset {}).await?;
            // From here on it counts from where the arm stands, and the arm stays where it is.
            let stands = asked(&cx, &mcs, ReadPosition {}).await?;
            assert_eq!(stands.commanded, stands.joints);
            for _ in 0..5 {
                for way in ["0.05 -0.02 0.03 0.1 0 0.1", "-0.03 0.04 -0.01 -0.1 0 -0.08"] {
                    let moved = told(&cx, &format!("mvpos EXEC by FMSG 6 {way}")).await?;
                    assert!(moved.is_ok(), "{:?}", moved.reports);
                }
            }
            let there = asked(&cx, &mcs, ReadPosition {}).await?;
            for (joint, sum) in [0.1, 0.1, 0.1, 0.0, 0.0, 0.1].into_iter().enumerate() {
                let off = there.commanded[joint] - stands.joints[joint] - sum;
                assert!(off.abs() < 1e-9, "joint {}: {off} rad", joint + 1);
            }
            // The tool's shifts add up, too.
            for way in ["0.02 0 0.01 0 0 0", "-0.02 0 -0.01 0 0 0", "0 0.02 0 0 0 0"] {
                told(&cx, &format!("mvpos EXEC shift FMSG 6 {way}")).await?;
            }
            let after = asked(&cx, &mcs, ReadPosition {}).await?;
            let at = |position: &Position, row: usize| position.base_t_commanded[4 * row + 3];
            for (row, sum) in [0.0, 0.02, 0.0].into_iter().enumerate() {
                let off = at(&after, row) - at(&there, row) - sum;
                assert!(off.abs() < 1e-9, "axis {row}: {off} m");
            }
            Ok(String::new())
        })
    });
}
