//! What happens to an app, as the clients of its control socket hear it.

use std::sync::Arc;

use tokio::sync::broadcast;

use super::protocol::EndView;
use ctos_bootstrap::bootstrap::{BootEvent, Observer};

/// How many events a client may be behind before it loses some.
const BEHIND: usize = 1024;

/// What happens to an app, for its clients.
#[derive(Debug, Clone)]
pub(super) enum News {
    Event(BootEvent),
    Ended(EndView),
}

/// What happens to an app, for subscribers.
#[derive(Debug, Clone)]
pub(crate) struct Ticker(pub(super) broadcast::Sender<News>);

impl Ticker {
    /// An observer that tells `observer` and the clients.
    pub(crate) fn observe(observer: &Observer) -> (Self, Observer) {
        let ticker = Self(broadcast::channel(BEHIND).0);
        let (news, observer) = (ticker.0.clone(), observer.clone());
        let both: Observer = Arc::new(move |event: &BootEvent| {
            // Progress and log lines are asked for in other ways.
            if !matches!(event, BootEvent::Log { .. } | BootEvent::Progress(_)) {
                // Nobody may be listening.
                let _ = news.send(News::Event(event.clone()));
            }
            observer(event);
        });
        (ticker, both)
    }

    /// What happens from now on.
    pub(super) fn subscribe(&self) -> broadcast::Receiver<News> {
        self.0.subscribe()
    }
}

/// Ends when the app has.
pub(super) async fn ended(news: &mut broadcast::Receiver<News>) {
    while restarted(news).await.is_some() {}
}

/// The next chassis that is started again; `None` when the app has ended.
pub(super) async fn restarted(news: &mut broadcast::Receiver<News>) -> Option<String> {
    loop {
        match news.recv().await {
            Ok(News::Event(
                BootEvent::Awake { chassis, .. } | BootEvent::Restarted { chassis, .. },
            )) => return Some(chassis),
            Ok(News::Ended(_)) | Err(broadcast::error::RecvError::Closed) => return None,
            Ok(News::Event(_)) | Err(broadcast::error::RecvError::Lagged(_)) => {}
        }
    }
}
