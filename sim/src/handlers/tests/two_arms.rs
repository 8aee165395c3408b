//! Two nine-joint arms in one world, each driven by a task of its own, in virtual time.

use super::*;

/// What one driver read, as bits: positions and speeds of all ticks.
type Log = Arc<Mutex<Vec<Vec<u64>>>>;

/// Arguments of the driver's task.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SwingArgs {
    arm: String,
    /// After so many ticks it says nothing more.
    ticks: u64,
}

/// Swings all its joints by a proportional and differential law.
struct Swing {
    driver: Box<dyn ChannelDriver>,
    start: Option<Vec<f64>>,
    ticks: u64,
    log: Log,
}

impl Cyclic for Swing {
    fn tick(&mut self, tick: &Tick) {
        let mut readings = vec![SlotReading::default(); self.driver.slots()];
        self.driver.read(&mut readings).unwrap();
        let bits = readings
            .iter()
            .flat_map(|r| [r.position.to_bits(), r.velocity.to_bits()]);
        self.log.lock().unwrap().push(bits.collect());
        let start = self
            .start
            .get_or_insert_with(|| readings.iter().map(|r| r.position).collect());
        let to = 0.1 * (3.0 * tick.count as f64 * 4.5e-3).sin();
        let torques = readings
            .iter()
            .zip(start)
            .enumerate()
            .map(|(joint, (at, start))| {
                let stiff = if joint < 3 { 6000.0 } else { 400.0 };
                stiff * (*start + to - at.position) - 0.1 * stiff * at.velocity
            });
        let torques: Vec<f64> = torques.collect();
        if tick.count <= self.ticks {
            self.driver
                .write(&torques, Power::Released, PERIOD)
                .unwrap();
        }
    }
}

struct Task {
    swing: Option<Swing>,
    cycle: Option<CyclicHandle>,
}

impl EventHandler for Task {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Create
            && let Some(swing) = self.swing.take()
        {
            self.cycle = Some(cx.cyclic(PERIOD, swing));
        }
        Ok(())
    }
}

/// Ends the app after 2 s.
struct Watch;

impl EventHandler for Watch {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let child = cx.clone();
            cx.spawn(async move {
                child.sleep(Duration::from_secs(2)).await;
                child.finish(AppResult {
                    ok: true,
                    text: String::new(),
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

/// What left and right read in 2 s, where left is silent after `ticks`.
fn run(seed: u64, world: &str, ticks: u64) -> [Vec<Vec<u64>>; 2] {
    let folder = tempfile::tempdir().unwrap();
    let cell = folder.path().join("cell.toml");
    let arm = |name: &str, y: f64| {
        format!(
            "[[arm]]\nname = '{name}'\nmodel = 'testbed9'\nbase = {{ xyz = [0.0, {y:?}, 0.0] }}\nstart = [0.0, 0.0, 0.0, 0.0, 45.0, -90.0, 0.0, 45.0, 0.0]\n"
        )
    };
    std::fs::write(&cell, arm("left", 0.0) + &arm("right", 1.2)).unwrap();
    let text = format!(
        r#"
        [app]
        seed = {seed}
        until = "watch"
        [time]
        mode = "virtual"
        [chassis.motion]
        processors.left = {{}}
        processors.right = {{}}
        processors.world = {{}}
        [task.left]
        handler = "test.swing"
        on = "motion/left"
        args = {{ arm = "left", ticks = {ticks} }}
        [task.right]
        handler = "test.swing"
        on = "motion/right"
        args = {{ arm = "right", ticks = 1_000_000 }}
        [task.world]
        handler = "sim.world"
        on = "motion/{world}"
        args = {{ cell = '{}' }}
        [task.watch]
        handler = "test.watch"
        on = "motion/left"
        "#,
        cell.display()
    );
    let app = load_texts(&[("app.toml", text.as_str())], &[], &[]).unwrap();
    let logs = [Log::default(), Log::default()];
    let shared = logs.clone();
    let mut registry = Registry::new();
    register_world(&mut registry);
    let swing = registry.handler("test.swing", &[], move |cx| {
        let SwingArgs { arm, ticks } = cx.config().unwrap().args.parse()?;
        let log = Arc::clone(&shared[usize::from(arm == "right")]);
        let driver = open_arm(cx, &Node::table().with("arm", arm.as_str()))?;
        let swing = Swing {
            driver,
            start: None,
            ticks,
            log,
        };
        Ok(Task {
            swing: Some(swing),
            cycle: None,
        })
    });
    swing.args::<SwingArgs>();
    registry.handler("test.watch", &[], |_| Ok(Watch));
    let findings = registry.check(&app);
    assert!(!findings.has_errors(), "{findings}");
    let observer: boot::Observer = Arc::new(|_: &boot::BootEvent| {});
    let outcome = boot::boot(app, registry, &launcher(), &observer).unwrap();
    assert!(matches!(outcome.end, End::Finished(_)), "{:?}", outcome.end);
    logs.map(|log| log.lock().unwrap().clone())
}

/// Speeds of one tick.
fn speeds(bits: &[u64]) -> Vec<f64> {
    bits.chunks(2).map(|pair| f64::from_bits(pair[1])).collect()
}

#[test]
fn two_arms_in_one_world_move_the_same_to_the_bit_whenever_the_seed_is_the_same() {
    for world in ["world", "right"] {
        let first = run(5, world, 1_000_000);
        for log in &first {
            assert!(log.len() > 440, "{}", log.len());
            let fastest = log.iter().flat_map(|bits| speeds(bits)).fold(0.0, f64::max);
            assert!((0.1..2.0).contains(&fastest), "{fastest} rad/s");
        }
        assert!(first == run(5, world, 1_000_000), "world on `{world}`");
    }
}

#[test]
fn a_driver_that_falls_silent_brakes_its_arm_and_the_other_goes_on() {
    let [left, right] = run(5, "world", 200);
    let (last_left, last_right) = (left.last().unwrap(), right.last().unwrap());
    assert!(speeds(&left[200]).iter().any(|speed| speed.abs() > 0.05));
    assert_eq!(speeds(last_left), [0.0; 9]);
    assert!(speeds(last_right).iter().any(|speed| speed.abs() > 0.05));
    // The other arm does as it did beside one that moved.
    let [_, undisturbed] = run(5, "world", 1_000_000);
    assert!(right == undisturbed);
}
