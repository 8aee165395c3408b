//! What the tasks that serve a page have in common: an address that is bound before anything else is done, a
//! token for whoever may intervene, and a server on a thread of its own. Knows no page.

use std::{
    io,
    net::{SocketAddr, TcpListener},
};

use ctos::task::HandlerError;
use tokio::sync::oneshot;

/// An address that is bound, and not yet served.
pub(crate) struct Front {
    listener: TcpListener,
    /// Where it is, with the port that it was given.
    pub(crate) address: SocketAddr,
    /// What a page must show to intervene; nobody may when there is none.
    pub(crate) token: Option<String>,
}

impl Front {
    /// Binds `listen`. When control is allowed, `token` is what a page must show, or one that is drawn.
    ///
    /// # Errors
    /// The address is taken, or not this host's.
    pub(crate) fn bind(
        listen: SocketAddr,
        allow_control: bool,
        token: Option<&str>,
    ) -> Result<Self, HandlerError> {
        let listener = TcpListener::bind(listen).map_err(|error| failed(listen, &error))?;
        let address = listener.local_addr();
        Ok(Self {
            address: address.map_err(|error| failed(listen, &error))?,
            listener,
            token: match (allow_control, token) {
                (false, _) => None,
                (true, Some(token)) => Some(token.to_owned()),
                (true, None) => Some(drawn_token()?),
            },
        })
    }

    /// Serves it on a thread called `name`, until what is returned is sent or dropped.
    ///
    /// # Errors
    /// The system has no thread to give.
    pub(crate) fn serve<S, F>(
        self,
        name: &'static str,
        server: S,
    ) -> Result<oneshot::Sender<()>, HandlerError>
    where
        S: FnOnce(TcpListener, oneshot::Receiver<()>) -> F + Send + 'static,
        F: Future<Output = io::Result<()>>,
    {
        let Self {
            listener, address, ..
        } = self;
        let (stop, stopped) = oneshot::channel();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|error| failed(address, &error))?;
        let serve = move || {
            if let Err(error) = runtime.block_on(server(listener, stopped)) {
                tracing::error!(page = name, error = %error, "a page is not served any more");
            }
        };
        let thread = std::thread::Builder::new().name(name.to_owned());
        let spawned = thread.spawn(serve);
        spawned.map_err(|error| failed(address, &error))?;
        Ok(stop)
    }
}

fn failed(listen: SocketAddr, error: &io::Error) -> HandlerError {
    HandlerError::new(format!(
        "a page cannot be served at {listen}: {error}; choose another `listen`"
    ))
}

/// 128 bits that nobody guesses.
///
/// # Errors
/// The system has no randomness to give.
pub(crate) fn drawn_token() -> io::Result<String> {
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).map_err(io::Error::other)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn anywhere() -> SocketAddr {
        SocketAddr::from(([127, 0, 0, 1], 0))
    }

    #[test]
    fn a_token_is_there_only_where_control_is_allowed_and_none_is_drawn_twice() {
        let token = |control, token| Front::bind(anywhere(), control, token).unwrap().token;
        assert_eq!(token(false, Some("given")), None);
        assert_eq!(token(true, Some("given")).as_deref(), Some("given"));
        let drawn = token(true, None).unwrap();
        assert_eq!(drawn.len(), 32);
        assert_ne!(token(true, None), Some(drawn));
    }

    #[test]
    fn an_address_that_is_taken_is_refused_with_what_to_do() {
        let first = Front::bind(anywhere(), false, None).unwrap();
        let told = Front::bind(first.address, false, None).err().unwrap();
        let told = told.to_string();
        assert!(
            told.contains(&first.address.to_string()) && told.contains("`listen`"),
            "{told}"
        );
    }

    #[test]
    fn a_server_ends_when_nobody_wants_it_any_more() {
        let front = Front::bind(anywhere(), false, None).unwrap();
        let (ended, heard) = std::sync::mpsc::channel();
        let stop = front
            .serve("test", move |_, stopped| async move {
                let _ = stopped.await;
                ended.send(()).map_err(io::Error::other)
            })
            .unwrap();
        drop(stop);
        heard.recv().unwrap();
    }
}
