//! Signatures: what the holder of a key says is believed of whoever carries it.

use std::{path::Path, sync::Arc};

use rustls::{
    crypto::{CryptoProvider, ring},
    pki_types::{CertificateDer, UnixTime},
    sign::SigningKey,
};
use serde::{Deserialize, Serialize};
use webpki::{EndEntityCert, KeyUsage, anchor_from_trusted_cert};

use super::{
    Identity, KeyError, files,
    tls::{identity, unusable},
};

/// A signature, and the certificate by which it is believed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Signature {
    certificate: Vec<u8>,
    bytes: Vec<u8>,
}

#[cfg(test)]
impl Signature {
    /// The certificate of one with the signature of another.
    pub(super) fn of(one: &Self, another: &Self) -> Self {
        Self {
            certificate: one.certificate.clone(),
            bytes: another.bytes.clone(),
        }
    }
}

/// A key that signs, and the authority by which signatures of others are believed.
#[derive(derive_more::Debug)]
#[debug("Signer({:?})", self.identity)]
pub struct Signer {
    identity: Identity,
    certificate: CertificateDer<'static>,
    key: Arc<dyn SigningKey>,
    authority: CertificateDer<'static>,
    provider: CryptoProvider,
}

impl Signer {
    /// Reads `KEY.pem`, `KEY.key` and the authority's certificate.
    ///
    /// # Errors
    /// [`KeyError`] when a file is missing, is something else, or may be read by others.
    pub fn load(key: &Path, authority: &Path) -> Result<Self, KeyError> {
        let certificate = files::certificate(&files::with_ending(key, "pem"))?;
        let private = files::private_key(&files::with_ending(key, "key"))?;
        let provider = ring::default_provider();
        let key = provider.key_provider.load_private_key(private);
        Ok(Self {
            identity: identity(&certificate).ok_or(KeyError::NoRole)?,
            certificate,
            key: key.map_err(unusable)?,
            authority: files::certificate(authority)?,
            provider,
        })
    }

    /// Whose key it is.
    #[must_use]
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Signs. What is signed should begin with what it is meant for, so that it is not taken for something else.
    ///
    /// # Errors
    /// The key can make no signature.
    pub fn sign(&self, said: &[u8]) -> Result<Signature, KeyError> {
        let schemes = self.provider.signature_verification_algorithms;
        let schemes: Vec<_> = schemes.mapping.iter().map(|(scheme, _)| *scheme).collect();
        let none = || KeyError::Certificate("its key makes no known signature".to_owned());
        let signer = self.key.choose_scheme(&schemes).ok_or_else(none)?;
        Ok(Signature {
            certificate: self.certificate.to_vec(),
            bytes: signer.sign(said).map_err(unusable)?,
        })
    }

    /// Who has signed it.
    ///
    /// # Errors
    /// The certificate is not of this authority, or names no holder; or the signature is not of its key, or of other bytes.
    pub fn who_signed(&self, said: &[u8], signature: &Signature) -> Result<Identity, KeyError> {
        let shown = CertificateDer::from(signature.certificate.as_slice());
        let certificate = EndEntityCert::try_from(&shown).map_err(unusable)?;
        let anchors = [anchor_from_trusted_cert(&self.authority).map_err(unusable)?];
        let algorithms = self.provider.signature_verification_algorithms.all;
        let path = certificate.verify_for_usage(
            algorithms,
            &anchors,
            &[],
            // As TLS does.
            UnixTime::now(),
            KeyUsage::client_auth(),
            None,
            None,
        );
        path.map_err(unusable)?;
        let fits = |algorithm: &&dyn rustls::pki_types::SignatureVerificationAlgorithm| {
            let checked = certificate.verify_signature(*algorithm, said, &signature.bytes);
            checked.is_ok()
        };
        if !algorithms.iter().any(fits) {
            let text = "the signature does not fit what was said";
            return Err(KeyError::Certificate(text.to_owned()));
        }
        identity(&shown).ok_or(KeyError::NoRole)
    }
}
