//! Mutual TLS: both ends show a certificate of the same authority.

use std::{io, path::Path, sync::Arc};

use rustls::{
    ClientConfig, ClientConnection, RootCertStore, ServerConfig, StreamOwned,
    pki_types::{CertificateDer, ServerName},
    server::WebPkiClientVerifier,
};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_rustls::{TlsAcceptor, TlsConnector, client, server};

use super::{Identity, KeyError, files};

/// Every key has this name in addition to its holder's: which host answers does not matter, only its key.
pub(super) const SERVER_NAME: &str = "chassis.ctos";

/// What [`Keys::call_blocking`] makes of a connection.
pub type BlockingStream = StreamOwned<ClientConnection, std::net::TcpStream>;

/// A key, ready to prove who this process is, and the authority by which others prove it.
#[derive(derive_more::Debug)]
#[debug("Keys({:?})", self.identity)]
pub struct Keys {
    identity: Identity,
    acceptor: TlsAcceptor,
    page: TlsAcceptor,
    client: Arc<ClientConfig>,
}

impl Keys {
    /// Reads `KEY.pem`, `KEY.key` and the authority's certificate.
    ///
    /// # Errors
    /// [`KeyError`] when a file is missing, is something else, may be read by others, or does not fit
    /// the rest.
    pub fn load(key: &Path, authority: &Path) -> Result<Self, KeyError> {
        let certificate = files::certificate(&files::with_ending(key, "pem"))?;
        let identity = identity(&certificate).ok_or(KeyError::NoRole)?;
        let mut roots = RootCertStore::empty();
        let authority = files::certificate(authority)?;
        roots.add(authority).map_err(unusable)?;
        let roots = Arc::new(roots);
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let verifier =
            WebPkiClientVerifier::builder_with_provider(roots.clone(), provider.clone()).build();
        let verifier = verifier.map_err(unusable)?;
        let private = || files::private_key(&files::with_ending(key, "key"));
        let chain = vec![certificate];
        let server = ServerConfig::builder_with_provider(provider.clone())
            .with_safe_default_protocol_versions()
            .map_err(unusable)?;
        let client = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(unusable)?;
        let page = server.clone().with_no_client_auth();
        let page = page.with_single_cert(chain.clone(), private()?);
        let server = server.with_client_cert_verifier(verifier);
        let server = server.with_single_cert(chain.clone(), private()?);
        let client = client.with_root_certificates(roots);
        let client = client.with_client_auth_cert(chain, private()?);
        let (server, page) = (server.map_err(unusable)?, page.map_err(unusable)?);
        Ok(Self {
            identity,
            acceptor: TlsAcceptor::from(Arc::new(server)),
            page: TlsAcceptor::from(Arc::new(page)),
            client: Arc::new(client.map_err(unusable)?),
        })
    }

    /// For browsers, which have no key: it is they who learn who answers.
    pub fn page(&self) -> TlsAcceptor {
        self.page.clone()
    }

    /// Whose key it is.
    #[must_use]
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Proves who this is to the called side, and learns who that is.
    ///
    /// # Errors
    /// [`KeyError`] when the other end has no key of this authority, or does not take this one.
    pub async fn call<S: AsyncRead + AsyncWrite + Unpin>(
        &self,
        stream: S,
    ) -> Result<(client::TlsStream<S>, Identity), KeyError> {
        let name = ServerName::try_from(SERVER_NAME).map_err(unusable)?;
        let connector = TlsConnector::from(self.client.clone());
        let stream = connector.connect(name, stream).await?;
        let identity = first_identity(stream.get_ref().1.peer_certificates())?;
        Ok((stream, identity))
    }

    /// [`Self::call`] for programs that do nothing else meanwhile.
    ///
    /// # Errors
    /// As [`Self::call`].
    pub fn call_blocking(
        &self,
        mut stream: std::net::TcpStream,
    ) -> Result<(BlockingStream, Identity), KeyError> {
        let name = ServerName::try_from(SERVER_NAME).map_err(unusable)?;
        let mut connection = ClientConnection::new(self.client.clone(), name).map_err(unusable)?;
        while connection.is_handshaking() {
            connection.complete_io(&mut stream)?;
        }
        let identity = first_identity(connection.peer_certificates())?;
        Ok((StreamOwned::new(connection, stream), identity))
    }

    /// Proves who this is to a caller, and learns who that is.
    ///
    /// # Errors
    /// As [`Self::call`].
    pub async fn answer<S: AsyncRead + AsyncWrite + Unpin>(
        &self,
        stream: S,
    ) -> Result<(server::TlsStream<S>, Identity), KeyError> {
        let stream = self.acceptor.accept(stream).await?;
        let identity = first_identity(stream.get_ref().1.peer_certificates())?;
        Ok((stream, identity))
    }
}

fn first_identity(chain: Option<&[CertificateDer<'_>]>) -> Result<Identity, KeyError> {
    let first = chain.and_then(<[_]>::first);
    first.and_then(identity).ok_or(KeyError::NoRole)
}

/// Whose certificate it is. Whether to believe it is another matter.
pub(super) fn identity(certificate: &CertificateDer<'_>) -> Option<Identity> {
    let parsed = webpki::EndEntityCert::try_from(certificate).ok()?;
    let mut found = parsed.valid_uri_names().filter_map(Identity::of_uri);
    found.next()
}

fn unusable(error: impl std::error::Error + Send + Sync + 'static) -> KeyError {
    KeyError::Certificate(io::Error::other(error).to_string())
}
