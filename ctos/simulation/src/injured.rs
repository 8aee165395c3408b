//! The injuries of an app's configuration as faults of a simulated run. A lost packet is sent again
//! and comes late; a cut link breaks and heals.

use std::time::Duration;

use crate::{
    fault::{Fault, FaultKind},
    network::Disturbance,
};
use ctos_config::InjuryConfig;
use ctos_time::Instant;

/// What `config` does at some moments to links between chassis.
/// Streams have no bytes here after which they could break; that they do and are had anew is time only.
pub(super) fn faults(config: &InjuryConfig) -> Vec<Fault> {
    let cuts = config.cuts.iter().map(|cut| {
        let (at, until) = (Instant::START + cut.at, Instant::START + cut.until);
        Fault::between(&cut.one, &cut.other, FaultKind::Break, at).until(until)
    });
    cuts.collect()
}

/// What it does to each link from its beginning to its end.
pub(super) fn lasting(config: &InjuryConfig) -> Vec<Disturbance> {
    let extents = [
        ("loss", config.drop),
        ("delay", config.delay.1.as_secs_f64()),
    ];
    let there = extents.into_iter().filter(|(_, extent)| *extent > 0.0);
    let kinds = there.filter_map(|(kind, extent)| FaultKind::of(kind, extent));
    kinds
        .filter_map(|kind| disturbance(kind, Instant::LAST))
        .collect()
}

/// What a fault does to the frames of a link until `until`, if it loses or delays them.
pub(super) fn disturbance(kind: FaultKind, until: Instant) -> Option<Disturbance> {
    match kind {
        FaultKind::Loss { share_ppm } => Some((until, share_ppm, Duration::ZERO)),
        FaultKind::Delay { extra } => Some((until, 0, extra)),
        _ => None,
    }
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
