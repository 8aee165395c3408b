//! State that survives its process: where it is stored, and how a task stores it.

use futures_util::future::LocalBoxFuture;
use serde::Serialize;

use crate::{
    context::Context,
    handled::{Handled, HandlerError},
};

/// Where the states of tasks are stored whose configuration says `state = "durable"`. The runtime has none of its own:
/// a program brings one ([`Registry::states`](crate::registry::Registry::states)).
pub trait StateStore: Send + Sync {
    /// What the task stored last, in its last process or in this one; `None`: nothing yet.
    ///
    /// # Errors
    /// What is wrong with the store. It is as it was.
    fn load(&self, cx: &Context) -> Result<Option<Vec<u8>>, HandlerError>;

    /// Stores a state in place of the last one, and waits until it survives everything. A process that dies meanwhile
    /// leaves the one or the other.
    fn store<'a>(&'a self, cx: &'a Context, state: &'a [u8]) -> LocalBoxFuture<'a, Handled>;
}

impl Context {
    /// Stores the state of a task now, before the end of its handler, and waits until it survives the process. For what
    /// must be stored before the task sends or asks something, and for children, whose answers wait for nothing.
    /// `state` is the handler's [`Handover::State`](crate::handler::Handover::State). Does nothing unless the
    /// configuration says `state = "durable"`.
    ///
    /// # Errors
    /// Why it could not be stored.
    pub async fn keep<S: Serialize>(&self, state: &S) -> Handled {
        match &self.inner.kept {
            Some(_) => self.store_state(postcard::to_stdvec(state)?).await,
            None => Ok(()),
        }
    }

    /// Stores a state unless it is the one that was stored last.
    pub(crate) async fn store_state(&self, state: Vec<u8>) -> Handled {
        let Some(kept) = &self.inner.kept else {
            return Ok(());
        };
        let mut stored = kept.stored.lock().await;
        if !stored.loaded {
            return Err("what was stored before is not loaded yet".into());
        }
        if stored.torn || stored.state != state {
            stored.torn = true;
            let registry = self.registry();
            registry.state_store()?.store(self, &state).await?;
            stored.state = state;
            stored.torn = false;
        }
        Ok(())
    }

    /// What the task has stored, from which it goes on; `None` if it is not durable, or has stored nothing.
    pub(crate) async fn load_state(&self) -> Result<Option<Vec<u8>>, HandlerError> {
        let Some(kept) = &self.inner.kept else {
            return Ok(None);
        };
        let mut stored = kept.stored.lock().await;
        if !stored.loaded {
            stored.state = self
                .registry()
                .state_store()?
                .load(self)?
                .unwrap_or_default();
            stored.loaded = true;
            if !stored.state.is_empty() {
                let tap = &self.chassis().tap;
                tap.used(|| "the state that it had stored before".to_owned());
            }
        }
        Ok(Some(stored.state.clone()).filter(|state| !state.is_empty()))
    }
}
