//! How bridges join a network of zenoh: as a client of a router, or as the router of others. Knows no bridge.
#![cfg(feature = "zenoh")]

use std::time::Duration;

use serde_json::{Value, json};
use zenoh::{Config, Session, Wait};

/// How to join.
#[derive(Debug, Clone)]
pub struct Joining<'p> {
    /// The routers that are looked for.
    pub connect: &'p [String],
    /// Where others connect: it is a router then, and otherwise a client.
    pub listen: &'p [String],
    /// Certificate, its private half and the authority's certificate, as paths.
    pub keys: Option<&'p [String; 3]>,
    /// How long a client's attempt to reach a router may take.
    pub patience: Duration,
    /// Whether samples get the time at which they were put.
    pub stamps: bool,
    /// After this silence a router is given up; zenoh's own time if there is none.
    pub lease: Option<Duration>,
}

impl Joining<'_> {
    /// Joins. The caller waits.
    ///
    /// # Errors
    /// There is no router, an address cannot be listened at, or a key cannot be read.
    pub fn join(&self) -> zenoh::Result<Session> {
        zenoh::open(self.config()?).wait()
    }

    fn config(&self) -> zenoh::Result<Config> {
        let mut config = Config::default();
        for (key, value) in self.settings() {
            let set = config.insert_json5(key, &value.to_string());
            set.map_err(|error| format!("the setting {key} = {value}: {error}"))?;
        }
        Ok(config)
    }

    /// zenoh's settings by their keys.
    fn settings(&self) -> Vec<(&'static str, Value)> {
        let is_router = !self.listen.is_empty();
        let ms = |time: Duration| u64::try_from(time.as_millis()).unwrap_or(u64::MAX);
        let mut all = vec![
            ("mode", json!(if is_router { "router" } else { "client" })),
            ("listen/endpoints", json!(self.listen)),
            ("connect/endpoints", json!(self.connect)),
            // A router goes on without others, and keeps looking for them.
            (
                "connect/timeout_ms",
                json!({ "router": -1, "peer": -1, "client": ms(self.patience) }),
            ),
            (
                "connect/exit_on_failure",
                json!({ "router": false, "peer": false, "client": true }),
            ),
            (
                "connect/retry",
                json!({ "period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2 }),
            ),
            // Its defaults look for others on every interface.
            ("scouting/multicast/enabled", json!(false)),
            ("timestamping/enabled", json!(self.stamps)),
            ("transport/shared_memory/enabled", json!(false)),
        ];
        all.extend(
            self.lease
                .map(|lease| ("transport/link/tx/lease", json!(ms(lease)))),
        );
        if let Some([certificate, private, authority]) = self.keys {
            let mut endpoints = self.connect.iter().chain(self.listen);
            if endpoints.all(|endpoint| endpoint.starts_with("tls/")) {
                all.push(("transport/link/protocols", json!(["tls"])));
            }
            all.extend([
                ("transport/link/tls/root_ca_certificate", json!(authority)),
                ("transport/link/tls/listen_certificate", json!(certificate)),
                ("transport/link/tls/listen_private_key", json!(private)),
                ("transport/link/tls/connect_certificate", json!(certificate)),
                ("transport/link/tls/connect_private_key", json!(private)),
                ("transport/link/tls/enable_mtls", json!(true)),
                // Keys name their holder, not its host.
                ("transport/link/tls/verify_name_on_connect", json!(false)),
            ]);
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zenoh_knows_every_setting_and_takes_its_value() {
        let keys = ["a.pem", "a.key", "ca.pem"].map(str::to_owned);
        let here = ["tls/127.0.0.1:7448".to_owned()];
        for listen in [&[][..], &here] {
            let joining = Joining {
                connect: &["tls/10.0.0.5:7447".to_owned()],
                listen,
                keys: Some(&keys),
                patience: Duration::from_secs(1),
                stamps: true,
                lease: Some(Duration::from_secs(4)),
            };
            joining.config().unwrap();
        }
    }

    #[test]
    fn what_has_keys_and_no_plain_address_speaks_tls_only() {
        let keys = ["a.pem", "a.key", "ca.pem"].map(str::to_owned);
        let speaks = |endpoint: &str| {
            let joining = Joining {
                connect: &[endpoint.to_owned()],
                listen: &[],
                keys: Some(&keys),
                patience: Duration::from_secs(1),
                stamps: false,
                lease: None,
            };
            let mut settings = joining.settings().into_iter();
            let protocols = settings.find(|(key, _)| *key == "transport/link/protocols");
            protocols.map(|(_, value)| value)
        };
        assert_eq!(speaks("tls/10.0.0.5:7447"), Some(json!(["tls"])));
        assert_eq!(speaks("tcp/10.0.0.5:7447"), None);
    }
}
