//! Signatures: what the holder of a key says is believed of whoever carries it.

use std::{path::Path, sync::Arc};

use ctos::security::{Identity, Keys};
use rustls::{
    crypto::{CryptoProvider, ring},
    pki_types::{
        CertificateDer, PrivateKeyDer, SignatureVerificationAlgorithm, UnixTime, pem::PemObject,
    },
    sign::SigningKey,
};
use serde::{Deserialize, Serialize};
use webpki::{EndEntityCert, KeyUsage, anchor_from_trusted_cert};

/// A signature, and the certificate by which it is believed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Signature {
    pub certificate: Vec<u8>,
    pub bytes: Vec<u8>,
}

/// A key that signs, and the authority by which signatures of others are believed.
#[derive(Debug)]
pub(crate) struct Signer {
    identity: Identity,
    certificate: CertificateDer<'static>,
    key: Arc<dyn SigningKey>,
    authority: CertificateDer<'static>,
    provider: CryptoProvider,
}

fn unusable(error: impl std::fmt::Display) -> String {
    format!("the certificate cannot be used: {error}")
}

impl Signer {
    /// Reads `KEY.pem`, `KEY.key` and the authority's certificate.
    ///
    /// # Errors
    /// A file is missing, is something else, or may be read by others.
    pub(crate) fn load(key: &Path, authority: &Path) -> Result<Self, String> {
        // It checks the files, and names them.
        let keys = Keys::load(key, authority).map_err(|error| error.to_string())?;
        let file = |end: &str| format!("{}.{end}", key.display());
        let private = PrivateKeyDer::from_pem_file(file("key")).map_err(unusable)?;
        let provider = ring::default_provider();
        let key = provider.key_provider.load_private_key(private);
        Ok(Self {
            identity: keys.identity().clone(),
            certificate: CertificateDer::from_pem_file(file("pem")).map_err(unusable)?,
            key: key.map_err(unusable)?,
            authority: CertificateDer::from_pem_file(authority).map_err(unusable)?,
            provider,
        })
    }

    /// Whose key it is.
    pub(crate) fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Signs. What is signed should begin with what it is meant for, so that it is not taken for something else.
    ///
    /// # Errors
    /// The key can make no signature.
    pub(crate) fn sign(&self, said: &[u8]) -> Result<Signature, String> {
        let schemes = self.provider.signature_verification_algorithms;
        let schemes: Vec<_> = schemes.mapping.iter().map(|(scheme, _)| *scheme).collect();
        let signer = self.key.choose_scheme(&schemes);
        let signer = signer.ok_or("its key makes no known signature")?;
        Ok(Signature {
            certificate: self.certificate.to_vec(),
            bytes: signer.sign(said).map_err(unusable)?,
        })
    }

    /// Who has signed it.
    ///
    /// # Errors
    /// The certificate is not of this authority, or names no holder; or the signature is not of its key, or of other bytes.
    pub(crate) fn who_signed(
        &self,
        said: &[u8],
        signature: &Signature,
    ) -> Result<Identity, String> {
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
        let fits = |algorithm: &&dyn SignatureVerificationAlgorithm| {
            let checked = certificate.verify_signature(*algorithm, said, &signature.bytes);
            checked.is_ok()
        };
        if !algorithms.iter().any(fits) {
            return Err("the signature does not fit what was said".to_owned());
        }
        let mut holders = certificate.valid_uri_names().filter_map(holder);
        holders
            .next()
            .ok_or_else(|| "its certificate names no holder and role".to_owned())
    }
}

/// Whose certificate it is, as `ctos keys` writes it: `ctos:ROLE/NAME`.
fn holder(uri: &str) -> Option<Identity> {
    let (role, name) = uri.strip_prefix("ctos:")?.split_once('/')?;
    Some(Identity {
        name: name.to_owned(),
        role: role.parse().ok()?,
    })
}

#[cfg(test)]
mod tests {
    use ctos::security::{Role, make_key};

    use super::*;

    #[test]
    fn a_signature_is_believed_of_its_key_and_of_what_was_said_and_of_nothing_else() {
        let [ours, theirs] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
        let signer = |folder: &Path, name: &str| {
            let key = make_key(&folder.join(name), Role::Boot).unwrap();
            Signer::load(&key, &folder.join("ca.pem")).unwrap()
        };
        let [north, south] = ["north", "south"].map(|name| signer(ours.path(), name));
        let signed = south.sign(b"a parcel").unwrap();
        let who = north.who_signed(b"a parcel", &signed).unwrap();
        assert_eq!((who.name.as_str(), who.role), ("south", Role::Boot));
        assert!(north.who_signed(b"a parcel more", &signed).is_err());
        // With the certificate of another one, and of an authority that has the same name.
        let stolen = Signature {
            certificate: north.sign(b"a parcel").unwrap().certificate,
            ..signed
        };
        assert!(north.who_signed(b"a parcel", &stolen).is_err());
        let foreign = signer(theirs.path(), "south").sign(b"a parcel").unwrap();
        assert!(north.who_signed(b"a parcel", &foreign).is_err());
    }
}
