//! What zenoh is told: the configuration of the app in its words, and what must not be left to its defaults.
//!
//! Its defaults are made for discovery on a bench. They use multicast on every interface, listen at every
//! address, let everybody in, and their client gives up at once. Knows no session and no stream.

use std::time::Duration;

use serde_json::{Value, json};

use crate::{
    config::{LinkConfig, ZenohConfig, ZenohEndpoint, ZenohMode},
    security::KeyFiles,
};

/// Batches that may wait for a connection: the most that zenoh takes. With 64 KiB each they hold what
/// the windows of a few streams let out.
const BATCHES: u32 = 16;

/// zenoh tries a lost connection again after so long, ms; each time later, up to the last.
const RETRY_MS: (u32, u32) = (50, 500);

/// zenoh's settings by their keys, for the boot or for a chassis. zenoh waits for a router that does not answer as long as
/// `patience`.
pub(super) fn settings(
    config: &ZenohConfig,
    is_boot: bool,
    links: &LinkConfig,
    patience: Duration,
    keys: Option<&KeyFiles>,
) -> Vec<(&'static str, Value)> {
    let (mode, connect, listen) = match (config.mode, is_boot) {
        (ZenohMode::Peer, _) => ("peer", &config.connect[..], &config.listen[..]),
        (ZenohMode::Client, _) => ("client", &config.connect[..], &[][..]),
        // The boot is the router of its app, and the chassis find it where it listens.
        (ZenohMode::Router, true) => ("router", &config.connect[..], &config.listen[..]),
        (ZenohMode::Router, false) => ("client", &config.listen[..], &[][..]),
    };
    let texts = |endpoints: &[ZenohEndpoint]| {
        endpoints
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
    };
    let patience_ms = u64::try_from(patience.as_millis()).unwrap_or(u64::MAX);
    let timeout_us = u64::try_from(links.peer_timeout.as_micros()).unwrap_or(u64::MAX);
    let (first, longest) = RETRY_MS;
    let mut settings = vec![
        ("mode", json!(mode)),
        ("connect/endpoints", json!(texts(connect))),
        // Clients look until they have found a router; the others go on without, and keep looking.
        (
            "connect/timeout_ms",
            json!({ "router": -1, "peer": -1, "client": patience_ms }),
        ),
        (
            "connect/exit_on_failure",
            json!({ "router": false, "peer": false, "client": true }),
        ),
        (
            "connect/retry",
            json!({ "period_init_ms": first, "period_max_ms": longest, "period_increase_factor": 2 }),
        ),
        ("listen/endpoints", json!(texts(listen))),
        ("scouting/timeout", json!(patience_ms)),
        // The caller of a stream waits for its other end.
        ("scouting/delay", json!(0)),
        ("open/return_conditions/connect_scouted", json!(false)),
        ("open/return_conditions/declares", json!(false)),
        (
            "scouting/multicast/enabled",
            json!(config.multicast.is_some()),
        ),
        ("timestamping/enabled", json!(false)),
        ("transport/shared_memory/enabled", json!(false)),
        ("transport/link/tx/queue/size/data", json!(BATCHES)),
        // No connection is given up while the sessions above still hope for it.
        (
            "transport/link/tx/queue/congestion_control/block/wait_before_close",
            json!(timeout_us),
        ),
    ];
    if let Some(interface) = &config.multicast {
        settings.push(("scouting/multicast/interface", json!(interface)));
    }
    if let Some(keys) = keys {
        settings.extend(tls(config, keys));
    }
    settings
}

/// TLS with this app's keys. Where everything configured is TLS, peers without keys are refused. zenoh checks the
/// authority only, and the called side accepts any authority that browsers trust. So the identity of the other end
/// is proved over the stream itself.
fn tls(config: &ZenohConfig, keys: &KeyFiles) -> Vec<(&'static str, Value)> {
    let path = |path: &std::path::Path| json!(path.to_string_lossy());
    let mut endpoints = config.connect.iter().chain(&config.listen);
    let all = endpoints.all(|endpoint| endpoint.tls);
    let protocols = if all { &["tls"][..] } else { &["tls", "tcp"] };
    vec![
        ("transport/link/protocols", json!(protocols)),
        (
            "transport/link/tls/root_ca_certificate",
            path(&keys.authority),
        ),
        (
            "transport/link/tls/listen_certificate",
            path(&keys.certificate),
        ),
        ("transport/link/tls/listen_private_key", path(&keys.private)),
        (
            "transport/link/tls/connect_certificate",
            path(&keys.certificate),
        ),
        (
            "transport/link/tls/connect_private_key",
            path(&keys.private),
        ),
        ("transport/link/tls/enable_mtls", json!(true)),
        // Keys name their holder, not its host.
        ("transport/link/tls/verify_name_on_connect", json!(false)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(mode: ZenohMode) -> ZenohConfig {
        ZenohConfig {
            mode,
            connect: vec!["tls/10.0.0.5:7447".parse().unwrap()],
            listen: vec!["tls/127.0.0.1:7448".parse().unwrap()],
            multicast: Some("lo".to_owned()),
        }
    }

    fn keys() -> KeyFiles {
        KeyFiles::of("keys/cell".as_ref(), "keys/ca.pem".as_ref())
    }

    fn all(config: &ZenohConfig, is_boot: bool) -> Vec<(&'static str, Value)> {
        let links = LinkConfig::default();
        settings(
            config,
            is_boot,
            &links,
            Duration::from_secs(3),
            Some(&keys()),
        )
    }

    fn value(settings: &[(&'static str, Value)], key: &str) -> Value {
        let mut found = settings.iter().filter(|(name, _)| *name == key);
        let value = found.next().unwrap().1.clone();
        assert!(found.next().is_none(), "{key} twice");
        value
    }

    #[test]
    fn zenoh_knows_every_setting_and_takes_its_value() {
        for mode in [ZenohMode::Peer, ZenohMode::Client, ZenohMode::Router] {
            for is_boot in [true, false] {
                let mut told = ::zenoh::Config::default();
                for (key, value) in all(&config(mode), is_boot) {
                    told.insert_json5(key, &value.to_string())
                        .unwrap_or_else(|error| panic!("{key} = {value}: {error}"));
                }
            }
        }
    }

    #[test]
    fn the_boot_is_the_router_of_its_app_and_the_chassis_connect_to_it() {
        let config = config(ZenohMode::Router);
        let boot = all(&config, true);
        assert_eq!(value(&boot, "mode"), "router");
        assert_eq!(
            value(&boot, "listen/endpoints"),
            json!(["tls/127.0.0.1:7448"])
        );
        assert_eq!(
            value(&boot, "connect/endpoints"),
            json!(["tls/10.0.0.5:7447"])
        );
        let chassis = all(&config, false);
        assert_eq!(value(&chassis, "mode"), "client");
        assert_eq!(value(&chassis, "listen/endpoints"), json!([]));
        assert_eq!(
            value(&chassis, "connect/endpoints"),
            json!(["tls/127.0.0.1:7448"])
        );
    }

    #[test]
    fn plain_connections_are_made_only_where_one_is_configured() {
        let mut config = config(ZenohMode::Peer);
        let protocols = |config: &_| value(&all(config, false), "transport/link/protocols");
        assert_eq!(protocols(&config), json!(["tls"]));
        config.connect = vec!["tcp/10.0.0.5:7447".parse().unwrap()];
        assert_eq!(protocols(&config), json!(["tls", "tcp"]));
    }

    #[test]
    fn discovery_is_off_unless_an_interface_is_named() {
        let mut config = config(ZenohMode::Peer);
        let enabled = |config: &_| value(&all(config, false), "scouting/multicast/enabled");
        assert_eq!(enabled(&config), true);
        config.multicast = None;
        assert_eq!(enabled(&config), false);
    }
}
