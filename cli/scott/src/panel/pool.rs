//! Who meets the lines of a page for `scott --panel`: the objects of this process, or those of a running app.

use std::sync::{Mutex, PoisonError};

use futures_util::{FutureExt as _, future::BoxFuture};
use std::sync::Arc;

use super::service::Objects;
use crate::{attach::refusal, backend::Backend};

/// Those who are asked. A request that takes long keeps no other waiting: each has one for itself.
#[derive(Clone)]
pub(super) struct Pool {
    free: Arc<Mutex<Vec<Backend>>>,
}

impl Pool {
    pub(super) fn new(backend: Backend) -> Self {
        Self {
            free: Arc::new(Mutex::new(vec![backend])),
        }
    }

    fn meet(&self, line: &str) -> String {
        let Some(mut backend) = self.take() else {
            return refusal(line, "the app cannot be reached");
        };
        let told = backend.dispatch(line, 0);
        self.put_back(backend);
        told.unwrap_or_else(|_| refusal(line, "there is no answer"))
    }

    fn take(&self) -> Option<Backend> {
        let mut free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let found = match free.as_slice() {
            // The last one is the pattern of all others.
            [only] => only.again(),
            _ => free.pop(),
        };
        drop(free);
        found
    }

    fn put_back(&self, backend: Backend) {
        /// More at once are not kept.
        const MOST: usize = 16;
        let mut free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        if free.len() < MOST {
            free.push(backend);
        }
    }
}

impl Objects for Pool {
    fn ask(&self, line: String) -> BoxFuture<'static, String> {
        let pool = self.clone();
        async move {
            let asked = line.clone();
            // An object may take its time, and the others go on.
            let met = tokio::task::spawn_blocking(move || pool.meet(&line)).await;
            met.unwrap_or_else(|_| refusal(&asked, "there is no answer"))
        }
        .boxed()
    }
}
