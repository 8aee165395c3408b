//! How pages are served: HTTP with a bound for everything that a stranger does, over TLS wherever others
//! can reach it. Only requests that name this server are served. Knows no page.

use std::{
    convert::Infallible,
    io,
    net::{IpAddr, SocketAddr},
    sync::Arc,
    time::Duration,
};

use hyper::{
    HeaderMap, Request, Response, StatusCode,
    body::{Body, Incoming},
    header::{CONNECTION, HOST, HeaderName, HeaderValue, ORIGIN},
    server::conn::http1,
    service::{Service, service_fn},
};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::{net::TcpListener, task::JoinSet};

use super::{
    STRANGER_TIMEOUT,
    lobby::{Guest, Lobby},
};
use ctos_bootstrap::refusals::Refusals;
use ctos_link::{security::Keys, transport::Stream};
use ctos_time::Clock;

/// How many connections there are at a time. Browsers keep some open for nothing; those go first.
const CONNECTIONS: usize = 64;

/// How long a connection may be silent, and how long the head of a request may take.
const SILENCE: Duration = Duration::from_secs(10);

/// Pages that may not be served where they should be.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Others could read what is said, and say it themselves.
    #[error(
        "a page at {0}, where others can reach it, needs keys: make them with `ctos keys new keys/NAME --role boot` and name them in [security]; or listen at 127.0.0.1"
    )]
    NoKeys(SocketAddr),
    /// The system refused.
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// An address that is bound, and not yet served.
#[derive(derive_more::Debug)]
#[debug("Pages({})", self.url())]
pub struct Pages {
    listener: std::net::TcpListener,
    address: SocketAddr,
    keys: Option<Arc<Keys>>,
    site: Site,
}

impl Pages {
    /// Pages at `listener`: over TLS with `keys`, which they need beyond the loopback. `names` are those by
    /// which browsers may call this host besides its own name and its addresses.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn new(
        listener: std::net::TcpListener,
        keys: Option<Arc<Keys>>,
        names: &[String],
    ) -> Result<Self, OpenError> {
        let address = listener.local_addr()?;
        let is_loopback = address.ip().to_canonical().is_loopback();
        if keys.is_none() && !is_loopback {
            return Err(OpenError::NoKeys(address));
        }
        let mut names: Vec<String> = names.iter().map(|name| name.to_lowercase()).collect();
        if !is_loopback && let Ok(name) = std::fs::read_to_string("/proc/sys/kernel/hostname") {
            names.push(name.trim().to_lowercase());
        }
        Ok(Self {
            listener,
            address,
            keys,
            site: Site {
                names,
                any_origin: false,
                clock: Clock::real(),
                refusals: Refusals::default(),
            },
        })
    }

    /// Lets pages of other sites ask too: the service tells by the header `Origin` and by what they show.
    #[must_use]
    pub fn with_any_origin(mut self) -> Self {
        self.site.any_origin = true;
        self
    }

    /// Where they are, with the port that was given.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether only this host reaches them.
    #[must_use]
    pub fn is_loopback(&self) -> bool {
        self.address.ip().to_canonical().is_loopback()
    }

    /// The address of the first page.
    #[must_use]
    pub fn url(&self) -> String {
        let scheme = if self.keys.is_some() { "https" } else { "http" };
        format!("{scheme}://{}/", self.address)
    }

    /// Serves them for as long as the caller polls this.
    ///
    /// # Errors
    /// What the system says before anybody is served.
    pub async fn serve<S, B>(self, service: S) -> io::Result<Infallible>
    where
        S: Service<Request<Incoming>, Response = Response<B>, Error = Infallible>,
        S: Clone + Send + 'static,
        S::Future: Send,
        B: Body + From<String> + Send + 'static,
        B::Data: Send,
        B::Error: Into<Box<dyn std::error::Error + Send + Sync>>,
    {
        self.listener.set_nonblocking(true)?;
        let listener = TcpListener::from_std(self.listener)?;
        let tls = self.keys.map(|keys| keys.page());
        let site = Arc::new(self.site);
        let lobby = Lobby::new(CONNECTIONS);
        let mut serving = JoinSet::new();
        loop {
            let refuse = |caller: Option<&(_, SocketAddr)>, why: &str| {
                let who = caller.map_or("a browser".to_owned(), |(_, peer)| peer.to_string());
                site.refuse(&who, why);
            };
            let ((stream, peer), guest) = lobby.next(|| listener.accept(), refuse).await;
            while serving.try_join_next().is_some() {}
            let Ok(here) = stream.local_addr() else {
                continue;
            };
            let (tls, service) = (tls.clone(), service.clone());
            let caller = Caller {
                who: peer,
                here: here.ip(),
                site: site.clone(),
            };
            serving.spawn(async move {
                let stream = match tls {
                    None => Ok(Box::new(stream) as Stream),
                    Some(tls) => {
                        let met = tokio::time::timeout(STRANGER_TIMEOUT, tls.accept(stream)).await;
                        met.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
                            .map(|stream| Box::new(stream) as Stream)
                    }
                };
                match stream {
                    Ok(stream) => attend(guest, stream, caller, service).await,
                    Err(error) => caller.refuse(&error.to_string()),
                }
            });
        }
    }
}

/// What all connections share.
struct Site {
    names: Vec<String>,
    any_origin: bool,
    clock: Clock,
    refusals: Refusals,
}

/// One connection, of which nothing has been heard.
struct Caller {
    who: SocketAddr,
    /// The address of this host that it called.
    here: IpAddr,
    site: Arc<Site>,
}

impl Caller {
    fn refuse(&self, reason: &str) {
        self.site.refuse(&self.who.to_string(), reason);
    }
}

/// Answers the requests of a connection, until it ends or is turned out.
async fn attend<S, B>(guest: Guest, stream: Stream, caller: Caller, service: S)
where
    S: Service<Request<Incoming>, Response = Response<B>, Error = Infallible>,
    B: Body + From<String> + 'static,
    B::Error: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    let (seat, asking) = (guest.seat(), &caller);
    let answers = service_fn(move |request: Request<Incoming>| {
        let answer = match asking.site.meant(asking.here, request.headers()) {
            Ok(()) => Ok((seat.serve(), service.call(request))),
            Err(reason) => {
                asking.refuse(reason);
                Err(refusal(reason))
            }
        };
        async move {
            match answer {
                Ok((_served, answer)) => answer.await,
                Err(refusal) => Ok(refusal),
            }
        }
    });
    let served = http1::Builder::new()
        // Who has said all that it asks is answered all the same.
        .half_close(true)
        .timer(TokioTimer::new())
        .header_read_timeout(SILENCE)
        .serve_connection(TokioIo::new(stream), answers)
        .with_upgrades();
    // The end of a connection is nobody's failure.
    match guest.stay(served).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::debug!(error = %error, "a browser went away"),
        Err(turned) => caller.refuse(&turned.to_string()),
    }
}

fn refusal<B: From<String>>(reason: &str) -> Response<B> {
    let mut response = Response::new(B::from(format!("{reason}\n")));
    *response.status_mut() = StatusCode::FORBIDDEN;
    let close = HeaderValue::from_static("close");
    response.headers_mut().insert(CONNECTION, close);
    response
}

impl Site {
    fn refuse(&self, who: &str, reason: &str) {
        self.refusals.note(&self.clock, who, reason);
    }

    /// Whether a request was meant for this server. A page of another site, or a name that only seems to be
    /// this host's, must not reach it.
    fn meant(&self, here: IpAddr, headers: &HeaderMap) -> Result<(), &'static str> {
        let text = |name: HeaderName| headers.get(name).map(|value| value.to_str().unwrap_or("?"));
        let host = text(HOST).ok_or("a request without a host")?;
        if !self.is_ours(here, host) {
            return Err("this server is not called so; name it in `names`, or use its address");
        }
        match text(ORIGIN) {
            _ if self.any_origin => Ok(()),
            // No browser sends none with what changes anything; programs may.
            None => Ok(()),
            Some(origin) if origin == format!("http://{host}") => Ok(()),
            Some(origin) if origin == format!("https://{host}") => Ok(()),
            Some(_) => Err("a page of another site may not use this one"),
        }
    }

    /// Whether `host`, a name or an address with or without a port, is this server's.
    fn is_ours(&self, here: IpAddr, host: &str) -> bool {
        let here = here.to_canonical();
        let is_port = |port: &str| port.bytes().all(|byte| byte.is_ascii_digit());
        let name = match host.rsplit_once(':') {
            Some((name, port)) if is_port(port) => name,
            _ => host,
        };
        let bare = name
            .strip_prefix('[')
            .and_then(|name| name.strip_suffix(']'));
        if let Ok(named) = bare.unwrap_or(name).parse::<IpAddr>() {
            let named = named.to_canonical();
            return named == here || named.is_loopback() && here.is_loopback();
        }
        let name = name.to_lowercase();
        name == "localhost" && here.is_loopback() || self.names.contains(&name)
    }
}

#[cfg(test)]
mod tests {
    use std::{
        io::{Read as _, Write as _},
        net::TcpStream,
    };

    use http_body_util::Full;
    use hyper::body::Bytes;
    use rustls::pki_types::{CertificateDer, pem::PemObject};
    use tokio::sync::oneshot;

    use super::*;

    fn site(names: &[&str]) -> Site {
        Site {
            names: names.iter().map(|&name| name.to_owned()).collect(),
            any_origin: false,
            clock: Clock::virtual_clock(),
            refusals: Refusals::default(),
        }
    }

    fn headers(pairs: &[(&'static str, &str)]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.insert(*name, value.parse().unwrap());
        }
        headers
    }

    #[test]
    fn pages_of_other_sites_and_names_of_other_hosts_are_refused() {
        let meant = |here: &str, pairs: &[(&'static str, &str)]| {
            let site = site(&["cell.lab"]);
            site.meant(here.parse().unwrap(), &headers(pairs)).is_ok()
        };
        for (here, host) in [
            ("127.0.0.1", "127.0.0.1:7412"),
            ("127.0.0.1", "localhost:7412"),
            ("127.0.0.1", "[::1]:7412"),
            ("::1", "LOCALHOST"),
            ("10.0.0.7", "10.0.0.7:80"),
            ("::ffff:10.0.0.7", "10.0.0.7"),
            ("fe80::1", "[fe80::1]:1"),
            ("10.0.0.7", "Cell.lab:7412"),
        ] {
            assert!(meant(here, &[("host", host)]), "{host}");
            for (scheme, yes) in [("http", true), ("https", true), ("http://evil", false)] {
                let origin = format!("{scheme}://{host}");
                let told = meant(here, &[("host", host), ("origin", &origin)]);
                assert_eq!(told, yes, "{origin}");
            }
            assert!(!meant(here, &[("host", host), ("origin", "null")]));
        }
        for (here, host) in [
            ("127.0.0.1", "evil.example"),
            ("127.0.0.1", "evil.example:7412"),
            ("127.0.0.1", "10.0.0.7"),
            ("10.0.0.7", "evil.example"),
            ("10.0.0.7", "localhost"),
            ("10.0.0.7", "127.0.0.1"),
            ("10.0.0.7", "cell.lab.evil.example"),
            ("10.0.0.7", ""),
        ] {
            assert!(!meant(here, &[("host", host)]), "{host}");
        }
        assert!(!meant("127.0.0.1", &[]));
    }

    #[test]
    fn a_page_beyond_the_loopback_without_keys_is_refused_with_what_to_do() {
        let listener = std::net::TcpListener::bind("0.0.0.0:0").unwrap();
        let error = Pages::new(listener, None, &[]).unwrap_err().to_string();
        assert!(
            error.contains("ctos keys new") && error.contains("[security]"),
            "{error}"
        );
    }

    /// A server that says yes, until what is returned is dropped.
    fn served(keys: Option<Arc<Keys>>) -> (SocketAddr, oneshot::Sender<()>) {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let pages = Pages::new(listener, keys, &[]).unwrap();
        let address = pages.address();
        let (stop, stopped) = oneshot::channel::<()>();
        std::thread::spawn(move || {
            let yes = service_fn(|_| async { Ok(Response::new(Full::<Bytes>::from("yes"))) });
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build();
            runtime.unwrap().block_on(async {
                tokio::select! {
                    served = pages.serve(yes) => drop(served),
                    _ = stopped => {}
                }
            });
        });
        (address, stop)
    }

    fn get(stream: &mut (impl io::Read + io::Write), host: &str) -> String {
        let request = format!("GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }

    #[test]
    fn idle_connections_keep_no_browser_out_and_the_longest_silent_go() {
        let (address, _stop) = served(None);
        let half_open = || {
            let mut stream = TcpStream::connect(address).unwrap();
            stream.write_all(b"GET / HTTP/1.1\r\nHo").unwrap();
            stream
        };
        let mut silent: Vec<TcpStream> = (0..CONNECTIONS + 6).map(|_| half_open()).collect();
        for _ in 0..2 {
            let mut browser = TcpStream::connect(address).unwrap();
            assert!(get(&mut browser, "localhost").ends_with("yes"));
        }
        // Without waiting for any time-out.
        let closed = silent[0].read(&mut [0; 16]);
        assert!(matches!(closed, Ok(0) | Err(_)), "{closed:?}");
    }

    #[test]
    fn a_host_of_another_name_is_refused_at_the_door() {
        let (address, _stop) = served(None);
        let mut browser = TcpStream::connect(address).unwrap();
        let answer = get(&mut browser, "evil.example");
        assert!(answer.starts_with("HTTP/1.1 403"), "{answer}");
    }

    /// A browser without a key that was told to believe an authority.
    fn browser_of(authority: &std::path::Path) -> rustls::ClientConnection {
        let mut roots = rustls::RootCertStore::empty();
        let certificate = CertificateDer::from_pem_file(authority).unwrap();
        roots.add(certificate).unwrap();
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let client = rustls::ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(roots)
            .with_no_client_auth();
        let name = "chassis.ctos".try_into().unwrap();
        rustls::ClientConnection::new(Arc::new(client), name).unwrap()
    }

    #[test]
    fn with_keys_a_page_speaks_tls_to_browsers_that_have_none() {
        let folder = tempfile::tempdir().unwrap();
        let key = ctos_link::security::make_key(
            &folder.path().join("a"),
            ctos_link::security::Role::Boot,
        );
        let authority = folder.path().join("ca.pem");
        let keys = Keys::load(&key.unwrap(), &authority).unwrap();
        let (address, _stop) = served(Some(Arc::new(keys)));
        let mut stream = TcpStream::connect(address).unwrap();
        let mut tls = browser_of(&authority);
        let mut secured = rustls::Stream::new(&mut tls, &mut stream);
        let request = b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
        secured.write_all(request).unwrap();
        let mut answer = Vec::new();
        // It closes the connection without a goodbye of TLS.
        let _ = secured.read_to_end(&mut answer);
        assert!(answer.ends_with(b"yes"));
        // What is not over TLS gets nothing.
        let mut plain = TcpStream::connect(address).unwrap();
        plain.write_all(request).unwrap();
        let mut answer = Vec::new();
        let _ = plain.read_to_end(&mut answer);
        assert!(!answer.ends_with(b"yes"));
    }
}
