//! Keys as files: `NAME.pem` is a certificate, `NAME.key` its private half, for the user alone; `ca.pem`
//! and `ca.key` are the authority's.

use std::{
    fs,
    io::{self, Write},
    os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt},
    path::{Path, PathBuf},
};

use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, SanType,
};
use rustls::pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject};

use super::{Identity, KeyError, Role, tls};

/// The authority's name among the files; no key may have it.
const AUTHORITY: &str = "ca";

/// Makes the key `FOLDER/NAME` with `role`; in a folder without an authority, that first. Returns the
/// path without its ending, as the configuration names it.
///
/// # Errors
/// [`KeyError`]; an existing key is never replaced.
pub fn make_key(path: &Path, role: Role) -> Result<PathBuf, KeyError> {
    let name = path.file_name().unwrap_or_default();
    let name = name.to_string_lossy().into_owned();
    if !crate::config::is_name(&name) || name == AUTHORITY {
        return Err(KeyError::Name { name });
    }
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let made = fs::DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(folder);
    made.map_err(|error| file_error(folder, error))?;
    let issuer = authority(folder)?;
    let key = KeyPair::generate().map_err(certificate_error)?;
    let certificate = holder_params(&Identity { name, role })
        .and_then(|params| params.signed_by(&key, &issuer))
        .map_err(certificate_error)?;
    let path = path.to_owned();
    write_new(&with_ending(&path, "key"), &key.serialize_pem(), 0o600)?;
    write_new(&with_ending(&path, "pem"), &certificate.pem(), 0o644)?;
    Ok(path)
}

/// The files of a key, for a library that reads them itself.
#[cfg(feature = "zenoh")]
#[derive(Debug, Clone)]
pub struct KeyFiles {
    pub certificate: PathBuf,
    pub private: PathBuf,
    pub authority: PathBuf,
}

#[cfg(feature = "zenoh")]
impl KeyFiles {
    /// Those of a key without its ending.
    pub fn of(key: &Path, authority: &Path) -> Self {
        Self {
            certificate: with_ending(key, "pem"),
            private: with_ending(key, "key"),
            authority: authority.to_owned(),
        }
    }
}

/// A key in a folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listed {
    /// Its path without ending.
    pub path: PathBuf,
    /// Whose it is, and what that may do.
    pub identity: Identity,
    /// Whether its private half is there too.
    pub private: bool,
}

/// The keys in a folder, by name. Files that are no keys are passed over.
///
/// # Errors
/// When the folder cannot be read.
pub fn list_keys(folder: &Path) -> Result<Vec<Listed>, KeyError> {
    let files = fs::read_dir(folder).map_err(|error| file_error(folder, error))?;
    let mut keys = Vec::new();
    for file in files.flatten() {
        let path = file.path();
        if path.extension().is_none_or(|end| end != "pem") {
            continue;
        }
        let certificate = certificate(&path).ok();
        let identity = certificate.as_ref().and_then(tls::identity);
        keys.extend(identity.map(|identity| Listed {
            private: path.with_extension("key").exists(),
            path: path.with_extension(""),
            identity,
        }));
    }
    keys.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(keys)
}

pub(super) fn certificate(path: &Path) -> Result<CertificateDer<'static>, KeyError> {
    let text = fs::read(path).map_err(|error| file_error(path, error))?;
    CertificateDer::from_pem_slice(&text).map_err(no(path, "certificate"))
}

/// Reads a private key that only this user may read.
pub(super) fn private_key(path: &Path) -> Result<PrivateKeyDer<'static>, KeyError> {
    let text = private_text(path)?;
    PrivateKeyDer::from_pem_slice(text.as_bytes()).map_err(no(path, "private key"))
}

fn no<E>(path: &Path, what: &'static str) -> impl FnOnce(E) -> KeyError {
    let path = path.to_owned();
    move |_| KeyError::Content { path, what }
}

/// `path` with `.ending` behind it, whatever dots its name has.
pub(super) fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    name.into()
}

fn private_text(path: &Path) -> Result<String, KeyError> {
    let found = fs::metadata(path).map_err(|error| file_error(path, error))?;
    if found.permissions().mode() & 0o077 != 0 {
        return Err(KeyError::Open {
            path: path.to_owned(),
        });
    }
    fs::read_to_string(path).map_err(|error| file_error(path, error))
}

/// The authority of a folder, made when there is none.
fn authority(folder: &Path) -> Result<Issuer<'static, KeyPair>, KeyError> {
    let key_path = folder.join(AUTHORITY).with_extension("key");
    let certificate_path = key_path.with_extension("pem");
    let params = authority_params().map_err(certificate_error)?;
    if certificate_path.exists() || key_path.exists() {
        let key = KeyPair::from_pem(&private_text(&key_path)?);
        let key = key.map_err(no(&key_path, "private key"))?;
        return Ok(Issuer::new(params, key));
    }
    let key = KeyPair::generate().map_err(certificate_error)?;
    let certificate = params.self_signed(&key).map_err(certificate_error)?;
    write_new(&key_path, &key.serialize_pem(), 0o600)?;
    write_new(&certificate_path, &certificate.pem(), 0o644)?;
    Ok(Issuer::new(params, key))
}

/// The same each time, so that the authority's certificate need not be read to sign with its key.
fn authority_params() -> Result<CertificateParams, rcgen::Error> {
    let mut params = CertificateParams::new(Vec::new())?;
    params
        .distinguished_name
        .push(DnType::CommonName, "CTOS authority");
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
    Ok(params)
}

fn holder_params(identity: &Identity) -> Result<CertificateParams, rcgen::Error> {
    let mut params = CertificateParams::new(vec![tls::SERVER_NAME.to_owned()])?;
    params
        .distinguished_name
        .push(DnType::CommonName, identity.name.as_str());
    params
        .subject_alt_names
        .push(SanType::URI(identity.uri().try_into()?));
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![
        ExtendedKeyUsagePurpose::ServerAuth,
        ExtendedKeyUsagePurpose::ClientAuth,
    ];
    params.use_authority_key_identifier_extension = true;
    Ok(params)
}

/// Writes a file that must not exist, with its permissions from the first byte on.
fn write_new(path: &Path, text: &str, mode: u32) -> Result<(), KeyError> {
    let opened = fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(mode)
        .open(path);
    let mut file = opened.map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => KeyError::Exists {
            path: path.to_owned(),
        },
        _ => file_error(path, error),
    })?;
    file.write_all(text.as_bytes())
        .map_err(|error| file_error(path, error))
}

fn file_error(path: &Path, error: io::Error) -> KeyError {
    KeyError::File {
        path: path.to_owned(),
        error,
    }
}

fn certificate_error(error: rcgen::Error) -> KeyError {
    KeyError::Certificate(error.to_string())
}
