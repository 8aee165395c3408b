//! Keys made, read and shown to each other over the loopback.

use std::{os::unix::fs::PermissionsExt, path::Path};

use tokio::net::{TcpListener, TcpStream};

use super::*;

fn run<T>(test: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    runtime.unwrap().block_on(test)
}

fn keys(folder: &Path, name: &str, role: Role) -> Keys {
    let key = make_key(&folder.join(name), role).unwrap();
    Keys::load(&key, &folder.join("ca.pem")).unwrap()
}

/// What each end makes of the other.
async fn meet(caller: &Keys, answerer: &Keys) -> [Result<Identity, KeyError>; 2] {
    let listener = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
    let address = listener.local_addr().unwrap();
    let call = async {
        let stream = TcpStream::connect(address).await.unwrap();
        let (mut stream, identity) = caller.call(stream).await?;
        // In TLS 1.3 the caller learns only afterwards that its own certificate was refused.
        tokio::io::AsyncReadExt::read_u8(&mut stream).await?;
        Ok(identity)
    };
    let answer = async {
        let (stream, _) = listener.accept().await.unwrap();
        let (mut stream, identity) = answerer.answer(stream).await?;
        tokio::io::AsyncWriteExt::write_u8(&mut stream, 1).await?;
        tokio::io::AsyncWriteExt::flush(&mut stream).await?;
        Ok(identity)
    };
    let (called, answered) = futures_util::future::join(call, answer).await;
    [called, answered]
}

#[test]
fn each_end_learns_the_others_name_and_role() {
    let folder = tempfile::tempdir().unwrap();
    let watcher = keys(folder.path(), "panel", Role::Watch);
    let chassis = keys(folder.path(), "ws-1.lab", Role::Boot);
    let [called, answered] = run(meet(&watcher, &chassis));
    assert_eq!(&called.unwrap(), chassis.identity());
    let caller = answered.unwrap();
    assert_eq!((caller.name.as_str(), caller.role), ("panel", Role::Watch));
    assert!(caller.may(Role::Watch) && !caller.may(Role::Call));
}

#[test]
fn a_key_of_another_authority_is_refused_by_both_ends() {
    let [ours, theirs] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let ours = keys(ours.path(), "a", Role::Boot);
    let theirs = keys(theirs.path(), "a", Role::Boot);
    let [called, answered] = run(meet(&theirs, &ours));
    assert!(called.is_err() && answered.is_err());
    // One that believes us, but whom we do not believe.
    let [called, answered] = run(meet(&ours, &theirs));
    assert!(called.is_err() && answered.is_err());
}

#[test]
fn a_caller_without_a_key_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let chassis = keys(folder.path(), "a", Role::Boot);
    let refused = run(async {
        let listener = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
        let mut stream = TcpStream::connect(listener.local_addr().unwrap())
            .await
            .unwrap();
        let (accepted, _) = listener.accept().await.unwrap();
        tokio::io::AsyncWriteExt::write_all(&mut stream, b"ctos, and no TLS at all")
            .await
            .unwrap();
        chassis.answer(accepted).await.err()
    });
    assert!(refused.is_some());
}

#[test]
fn private_halves_belong_to_the_user_alone_and_keys_are_never_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = make_key(&folder.path().join("a"), Role::Call).unwrap();
    for name in ["a.key", "ca.key"] {
        let file = folder.path().join(name);
        let mode = std::fs::metadata(&file).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "{name}");
    }
    let before = std::fs::read(folder.path().join("a.key")).unwrap();
    let again = make_key(&path, Role::Boot).unwrap_err();
    assert!(matches!(again, KeyError::Exists { .. }), "{again}");
    assert_eq!(std::fs::read(folder.path().join("a.key")).unwrap(), before);
    let open = std::fs::Permissions::from_mode(0o644);
    std::fs::set_permissions(folder.path().join("a.key"), open).unwrap();
    let error = Keys::load(&path, &folder.path().join("ca.pem")).unwrap_err();
    assert!(error.to_string().contains("chmod 600"), "{error}");
}

#[test]
fn a_folder_lists_its_keys_with_their_roles_and_not_the_authority() {
    let folder = tempfile::tempdir().unwrap();
    for (name, role) in [("b", Role::Control), ("a", Role::Watch)] {
        make_key(&folder.path().join(name), role).unwrap();
    }
    std::fs::write(folder.path().join("rubbish.pem"), "rubbish").unwrap();
    std::fs::remove_file(folder.path().join("a.key")).unwrap();
    let listed = list_keys(folder.path()).unwrap();
    let shown: Vec<_> = listed
        .iter()
        .map(|key| (key.identity.name.as_str(), key.identity.role, key.private))
        .collect();
    assert_eq!(
        shown,
        [("a", Role::Watch, false), ("b", Role::Control, true)]
    );
}

#[test]
fn names_that_cannot_stand_in_a_certificate_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["ca", "a b", "ä", "..", &"x".repeat(65)] {
        let error = make_key(&folder.path().join(name), Role::Call).unwrap_err();
        assert!(matches!(error, KeyError::Name { .. }), "{name}: {error}");
    }
}

#[test]
fn roles_include_those_before_them() {
    for (index, role) in Role::ALL.into_iter().enumerate() {
        assert_eq!(role.to_string().parse(), Ok(role));
        let holder = Identity {
            name: "a".to_owned(),
            role,
        };
        let may: Vec<bool> = Role::ALL
            .into_iter()
            .map(|needed| holder.may(needed))
            .collect();
        assert_eq!(may.iter().filter(|may| **may).count(), index + 1);
    }
    assert!("root".parse::<Role>().is_err());
}
