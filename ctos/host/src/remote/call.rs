//! How a boot comes to an agent: calls it, says who it is, compares the clocks of both hosts, and sends the
//! app.

use std::time::Duration;

use super::{
    link::Link,
    wire::{
        AppFiles, BUNDLE_LIMIT, Connection, FRAME_LIMIT, GREETING, HELLO_TIMEOUT, HandlerView,
        HelloAnswer, Outbox, ToAgent, ToBoot,
    },
};
use crate::doors::Secret;
use ctos_bootstrap::bootstrap::HostError;
use ctos_config::App;
use ctos_core::registry::Registry;
use ctos_link::{
    handshake::{self, HandshakeError, Process, Token},
    security::Role,
    transport::{Address, ConnectError, Stream, connect},
};

/// From how many answers it is learnt what the agent's clock shows.
const SAMPLES: u64 = 5;

/// What agents need of the app.
pub(super) fn files(
    app: &App,
    registry: &Registry,
    options: &[String],
) -> Result<AppFiles, String> {
    let bundle = app.bundle().map_err(|finding| finding.to_string())?;
    let size: usize = bundle.files.values().map(String::len).sum();
    if size + FRAME_LIMIT > BUNDLE_LIMIT {
        return Err(format!(
            "the app's files come to {} MiB, and an agent takes less than {}: have large data files on the hosts that need them",
            size >> 20,
            BUNDLE_LIMIT >> 20
        ));
    }
    let mut handlers: Vec<&str> = app.tasks.iter().map(|task| task.handler.as_str()).collect();
    handlers.sort_unstable();
    handlers.dedup();
    let kinds = handlers.into_iter().filter_map(|name| registry.kind(name));
    Ok(AppFiles {
        bundle,
        options: options.to_vec(),
        handlers: kinds
            .map(|kind| HandlerView {
                name: kind.name().to_owned(),
                commands: kind
                    .commands()
                    .iter()
                    .map(|command| (command.code, command.name.to_owned()))
                    .collect(),
            })
            .collect(),
        recorded: app.record.is_some(),
    })
}

/// The clocks of both hosts, compared.
#[derive(Clone, Copy)]
pub(super) struct Compared {
    /// The start of the app on the agent's monotonic clock, ns.
    pub(super) origin_ns: u64,
    /// Within so much.
    within: Duration,
}

impl Link {
    /// Begins a run at the agent.
    pub(super) async fn open(&mut self) -> Result<Connection, HostError> {
        let run = Token::fresh().map_err(|error| self.error(error.to_string()))?;
        self.hello.run = run;
        self.hello.replaces = self.last_run.clone();
        let (mut connection, _) = self.call().await?;
        self.begin(&mut connection).await?;
        self.last_run = Some(self.hello.run.clone());
        Ok(connection)
    }

    /// Connects to the agent: whether it knows the run.
    pub(super) async fn call(&mut self) -> Result<(Connection, bool), HostError> {
        let called = tokio::time::timeout(HELLO_TIMEOUT, self.say_hello()).await;
        let called = called.unwrap_or_else(|_| {
            Err(format!(
                "its agent does not answer within {} s; is the host up, and its agent not stuck?",
                HELLO_TIMEOUT.as_secs()
            ))
        });
        let (stream, known, process) = called.map_err(|reason| self.error(reason))?;
        self.compared = None;
        if Process::this().sees(&process) {
            // It has the same clock.
            self.compared = Some(Compared {
                origin_ns: self.clock.origin_ns().unwrap_or(0),
                within: Duration::ZERO,
            });
        }
        // An empty outbox: orders that waited for the lost connection are given anew, where they still count.
        self.outbox = Outbox::new(|_| false);
        self.pinged = None;
        let connection = Connection::new(stream, self.outbox.clone(), FRAME_LIMIT, self.silence);
        Ok((connection, known))
    }

    async fn say_hello(&self) -> Result<(Stream, bool, Process), String> {
        let agent = Address::Tcp(self.host.agent);
        let (mut stream, identity) = connect(&agent, self.keys.as_ref(), None)
            .await
            .map_err(|error| self.explained(&error))?;
        if let Some(identity) = identity.filter(|identity| !identity.may(Role::Boot)) {
            return Err(format!(
                "its agent has the key `{}` with the role `{}`, and chassis need `boot`",
                identity.name, identity.role
            ));
        }
        let mut hello = self.hello.clone();
        if self.keys.is_none() {
            // Without it the agent says what is missing.
            hello.secret = Secret::of_port(self.host.agent).ok();
        }
        let answer = async {
            handshake::greet(&mut stream, GREETING, &hello).await?;
            handshake::hear::<HelloAnswer>(&mut stream).await
        };
        match answer.await {
            Ok(HelloAnswer::Welcome { known, process }) => Ok((stream, known, process)),
            Ok(HelloAnswer::Refused { reason }) => Err(format!("its agent refuses: {reason}")),
            // Of TLS this end sees rubbish.
            Err(error) if self.keys.is_none() => Err(format!(
                "its agent does not answer as one ({error}); does it want keys? name them in [security]"
            )),
            Err(HandshakeError::Io(error)) => Err(format!(
                "its agent hung up ({error}); its key and that of the app must be of one authority"
            )),
            Err(error) => Err(format!("what answers there is no agent: {error}")),
        }
    }

    /// What a connection that could not be made means for a person.
    fn explained(&self, error: &ConnectError) -> String {
        match error {
            ConnectError::Io { error, .. } => {
                let key = match self.keys {
                    Some(_) => " --key keys/NAME",
                    None => "",
                };
                format!(
                    "its agent cannot be reached: {error}; start it there: ctos agent --listen {}{key}",
                    self.host.agent
                )
            }
            ConnectError::Key { error, .. } => format!(
                "its agent does not prove who it is: {error}; it needs `--key` with a key of the app's authority"
            ),
        }
    }

    /// Sends the app, and compares the clocks.
    pub(super) async fn begin(&mut self, connection: &mut Connection) -> Result<(), HostError> {
        let timeout = self.phase;
        let begun = async {
            for _ in 0..SAMPLES {
                self.ping();
                let is_pong = |said: &ToBoot| matches!(said, ToBoot::Pong { .. });
                self.hear_until(connection, is_pong).await?;
            }
            let files = (*self.files).clone();
            self.outbox.say(ToAgent::App(Box::new(files)));
            self.hear_until(connection, |said| *said == ToBoot::Unpacked)
                .await
        };
        let begun = tokio::time::timeout(timeout, begun).await;
        let begun = begun.unwrap_or_else(|_| {
            Err(format!(
                "its agent did not take the app within {:.3} s",
                timeout.as_secs_f64()
            ))
        });
        begun.map_err(|reason| self.error(reason))
    }

    async fn hear_until(
        &mut self,
        connection: &mut Connection,
        is_it: impl Fn(&ToBoot) -> bool,
    ) -> Result<(), String> {
        loop {
            let said = connection.hear().await.map_err(|error| error.to_string())?;
            let done = is_it(&said);
            self.heard(said)?;
            if done {
                return Ok(());
            }
        }
    }

    pub(super) fn ping(&mut self) {
        self.pings += 1;
        self.pinged = Some((self.pings, self.clock.now()));
        self.outbox.say(ToAgent::Ping { number: self.pings });
    }

    /// Learns what the agent's clock shows from an answer that was not long under way.
    pub(super) fn pong(&mut self, number: u64, monotonic_ns: u64) {
        let Some((_, asked)) = self.pinged.take_if(|(asked, _)| *asked == number) else {
            return;
        };
        let way = self.clock.now().since(asked) / 2;
        let better = |compared: &Compared| way < compared.within;
        if self.compared.as_ref().is_none_or(better) {
            let elapsed = (asked + way).as_nanos();
            self.compared = Some(Compared {
                origin_ns: monotonic_ns.saturating_sub(elapsed),
                within: way,
            });
        }
    }
}
