//! The injuries of an app's configuration as faults of a simulated run: a packet that is lost is sent
//! again and comes late, a link that is cut breaks and heals.

use crate::fault::Fault;
use ctos_config::InjuryConfig;
use ctos_time::Instant;

/// The end of what lasts.
const FOR_GOOD: Instant = Instant::from_nanos(u64::MAX);

/// What `config` does to the links between the chassis of these names, from the start and later.
/// Streams have no bytes here after which they could break; that they do and are had anew is time only.
pub(super) fn faults(config: &InjuryConfig, names: &[String]) -> Vec<Fault> {
    let mut all = Vec::new();
    let pairs = || {
        let firsts = names.iter().enumerate();
        firsts.flat_map(|(index, one)| names.iter().skip(index + 1).map(move |other| (one, other)))
    };
    for (one, other) in pairs() {
        let (one, other) = (one.clone(), other.clone());
        all.extend(lasting(config, &one, &other));
    }
    for cut in &config.cuts {
        all.push(Fault::Break {
            one: cut.one.clone(),
            other: cut.other.clone(),
            at: Instant::START + cut.at,
            until: Instant::START + cut.until,
        });
    }
    all
}

/// What it does to one link from its beginning to its end.
pub(super) fn lasting(config: &InjuryConfig, one: &str, other: &str) -> Vec<Fault> {
    let mut all = Vec::new();
    // At most 0.9, so the product fits.
    let share_ppm = (config.drop * 1e6).round() as u32;
    if share_ppm > 0 {
        all.push(Fault::Loss {
            one: one.to_owned(),
            other: other.to_owned(),
            at: Instant::START,
            until: FOR_GOOD,
            share_ppm,
        });
    }
    let (_, extra) = config.delay;
    if !extra.is_zero() {
        all.push(Fault::Delay {
            one: one.to_owned(),
            other: other.to_owned(),
            at: Instant::START,
            until: FOR_GOOD,
            extra,
        });
    }
    all
}

#[cfg(test)]
mod tests {
    use crate::{Setup, run};
    use ctos_bootstrap::bootstrap::{End, Observer};
    use ctos_config::load_texts;
    use ctos_core::{
        context::Context, envelope::Message, handled::Handled, handler::EventHandler, phase::Phase,
        registry::Registry,
    };
    use ctos_time::Instant;

    /// Pings a task of another chassis a hundred times, one after the other.
    struct Pings;

    impl EventHandler for Pings {
        async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
            cx.default_processing(message)
        }

        async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
            if phase == Phase::Run {
                let cx = cx.clone();
                cx.clone().spawn(async move {
                    let far = cx.task("far").await.unwrap();
                    for _ in 0..100 {
                        cx.call(&far, ctos_core::system::Ping {}).await.unwrap();
                    }
                    cx.finish(ctos_core::system::AppResult {
                        ok: true,
                        text: String::new(),
                        json: "{}".to_owned(),
                    });
                });
            }
            Ok(())
        }
    }

    struct Idle;

    impl EventHandler for Idle {
        async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
            cx.default_processing(message)
        }
    }

    /// When the app has ended.
    fn takes(injure: &str) -> Instant {
        let text = format!(
            "[app]\nuntil = \"near\"\n[chassis.a]\n[chassis.b]\n\
             [task.near]\nhandler = \"pings\"\non = \"a\"\n\
             [task.far]\nhandler = \"idle\"\non = \"b\"\n{injure}"
        );
        let app = load_texts(&[("injured.toml", &text)], &[], &[]).unwrap();
        let mut registry = Registry::new();
        registry.handler("pings", &[], |_| Ok(Pings));
        registry.handler("idle", &[], |_| Ok(Idle));
        let setup = Setup::default();
        let clock = setup.clock.clone();
        let silent: Observer = std::sync::Arc::new(|_| ());
        let ran = run(app, registry, setup, &silent).unwrap();
        assert!(matches!(ran.outcome.end, End::Finished(_)), "{ran:?}");
        assert!(ran.faults.is_empty(), "{:?}", ran.faults);
        clock.now()
    }

    #[test]
    fn injured_links_of_a_virtual_run_are_slower_and_lose_nothing() {
        let whole = takes("");
        for injure in ["drop = 0.3", "delay = \"50ms\"", "cut = [\"a:b@0s+1s\"]"] {
            let injured = takes(&format!("[injure]\n{injure}\n"));
            let later = injured.since(whole);
            assert!(
                later > std::time::Duration::from_millis(500),
                "{injure}: {later:?}"
            );
        }
    }
}
