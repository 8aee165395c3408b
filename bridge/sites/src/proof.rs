//! How gates prove who they are: whatever one says is signed by the key of its site, and is believed of nobody else. Knows no
//! session.

use std::collections::BTreeMap;

use ctos::{config::App, security::Role};
use serde::Serialize;

use crate::{
    signature::{Signature, Signer},
    wire::{Beat, Ended, Head, written},
};

/// What is signed, with the key of the network under which it is said.
#[derive(Debug, Clone, Copy, Serialize)]
pub(crate) enum Said<'s> {
    /// A gate is there.
    Beat(&'s str, Beat),
    /// A request, and its data.
    Ask(&'s str, Head, &'s [u8]),
    /// How the request of that signature ended, and the data of its reply: no other request has this answer.
    Answer(&'s str, Option<&'s Signature>, &'s Ended, &'s [u8]),
}

impl Said<'_> {
    fn bytes(self) -> Vec<u8> {
        // So that no signature for anything else is one of these.
        written(&("ctos/site", self))
    }
}

/// Signs what this site says, and checks what others do. Without keys names are believed: only the loopback has none.
#[derive(Debug)]
pub(crate) struct Prover {
    signer: Option<Signer>,
}

impl Prover {
    /// With the keys of the app.
    ///
    /// # Errors
    /// A key cannot be read, or is not one of the site.
    pub(crate) fn new(app: &App, site: &str) -> Result<Self, String> {
        let signer = signer(app).transpose()?;
        if let Some(signer) = &signer {
            is_of(signer, site)?;
        }
        Ok(Self { signer })
    }

    /// That this site says it.
    pub(crate) fn sign(&self, said: Said<'_>) -> Option<Signature> {
        let signed = self.signer.as_ref()?.sign(&said.bytes());
        let told = |error: &String| tracing::error!(error, "what this site says is not signed");
        signed.inspect_err(told).ok()
    }

    /// Checks that `site` says it.
    ///
    /// # Errors
    /// Why that is not believed.
    pub(crate) fn check(
        &self,
        site: &str,
        said: Said<'_>,
        signature: Option<&Signature>,
    ) -> Result<(), String> {
        let Some(signer) = &self.signer else {
            return Ok(());
        };
        let signature = signature.ok_or("it is not signed")?;
        let who = signer.who_signed(&said.bytes(), signature)?;
        if who.name != site {
            return Err(format!("it is signed by the key of `{}`", who.name));
        }
        if !who.may(Role::Boot) {
            let role = who.role;
            return Err(format!("its key has the role {role}, and gates have boot"));
        }
        Ok(())
    }
}

/// The app's keys, if it has any.
fn signer(app: &App) -> Option<Result<Signer, String>> {
    let security = app.security.as_ref()?;
    let [key, authority] = [&security.key, &security.authority].map(|file| app.folder.join(file));
    Some(Signer::load(&key, &authority))
}

/// Whether a site may prove itself by a key.
fn is_of(signer: &Signer, site: &str) -> Result<(), String> {
    let whose = signer.identity();
    if whose.name != site || !whose.may(Role::Boot) {
        return Err(format!(
            "site `{site}` proves who it is by a key of its name with the role boot, and [security] has one of `{}` with the role {}",
            whose.name, whose.role
        ));
    }
    Ok(())
}

/// What is wrong with the app's key, if it can be read: that it is there is the boot's to check.
pub(crate) fn wrong_key(app: &App, site: &str) -> Option<String> {
    let signer = signer(app)?.ok()?;
    is_of(&signer, site).err()
}

/// Which requests of another site have come, so that none is taken twice: routers could repeat them.
#[derive(Debug, Default)]
pub(crate) struct Numbers {
    /// For each run of its gate.
    runs: BTreeMap<u64, Window>,
}

/// The highest number, and bits for it and those just below.
#[derive(Debug, Default)]
struct Window {
    highest: u64,
    seen: u128,
}

/// A gate that was started so often meanwhile is not believed any more.
const MOST_RUNS: usize = 10_000;

impl Numbers {
    /// Whether this request, counted from 1 by each run, is new.
    pub(crate) fn take(&mut self, run: u64, number: u64) -> bool {
        if self.runs.len() >= MOST_RUNS && !self.runs.contains_key(&run) {
            return false;
        }
        self.runs.entry(run).or_default().take(number)
    }
}

impl Window {
    fn take(&mut self, number: u64) -> bool {
        let far = |distance: u64| u32::try_from(distance).unwrap_or(u32::MAX);
        if number > self.highest {
            let moved = self.seen.checked_shl(far(number - self.highest));
            self.seen = moved.unwrap_or(0) | 1;
            self.highest = number;
            return true;
        }
        // One that so many have overtaken counts as repeated.
        let bit = 1_u128.checked_shl(far(self.highest - number));
        let is_new = bit.is_some_and(|bit| self.seen & bit == 0) && number > 0;
        self.seen |= bit.unwrap_or(0);
        is_new
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::{path::Path, time::Duration};

    use ctos::security::make_key;

    use super::*;

    impl Prover {
        /// One that believes names.
        pub(crate) fn without_keys() -> Self {
            Self { signer: None }
        }
    }

    /// One that signs with a key, which is made in the folder.
    pub(crate) fn with_key(folder: &Path, name: &str, role: Role) -> Prover {
        let key = make_key(&folder.join(name), role).unwrap();
        let signer = Signer::load(&key, &folder.join("ca.pem")).unwrap();
        Prover {
            signer: Some(signer),
        }
    }

    /// Why it is not believed that a site says this.
    fn why(by: &Prover, site: &str, said: Said<'_>, signed: &Option<Signature>) -> String {
        by.check(site, said, signed.as_ref()).unwrap_err()
    }

    #[test]
    fn what_a_site_says_is_believed_of_its_key_only_and_of_exactly_that() {
        let folder = tempfile::tempdir().unwrap();
        let prover = |name| with_key(folder.path(), name, Role::Boot);
        let [north, south, west] = ["north", "south", "west"].map(prover);
        let panel = with_key(folder.path(), "panel", Role::Call);
        let head = Head::new(Duration::from_secs(1), true, 7, 1);
        let said = Said::Ask("a/key", head, b"hat");
        let signed = south.sign(said);
        assert_eq!(north.check("south", said, signed.as_ref()), Ok(()));
        assert_eq!(
            why(&north, "south", said, &west.sign(said)),
            "it is signed by the key of `west`"
        );
        assert_eq!(why(&north, "south", said, &None), "it is not signed");
        assert!(why(&north, "panel", said, &panel.sign(said)).contains("has the role call"));
        let later = Head::new(Duration::from_secs(1), true, 7, 2);
        let done: Ended = Ok(());
        for other in [
            Said::Ask("another/key", head, b"hat"),
            Said::Ask("a/key", later, b"hat"),
            Said::Ask("a/key", head, b"hats"),
            Said::Answer("a/key", None, &done, b"hat"),
        ] {
            assert!(why(&north, "south", other, &signed).contains("does not fit"));
        }
        // An answer belongs to one request, also of a gate that was started anew and counts from 1 again.
        let answer = Said::Answer("a/key", signed.as_ref(), &done, b"hat");
        let answered = south.sign(answer);
        assert_eq!(north.check("south", answer, answered.as_ref()), Ok(()));
        for asked in [Head::new(Duration::from_secs(1), true, 8, 1), later] {
            let signed = south.sign(Said::Ask("a/key", asked, b"hat"));
            let answer = Said::Answer("a/key", signed.as_ref(), &done, b"hat");
            assert!(why(&north, "south", answer, &answered).contains("does not fit"));
        }
    }

    #[test]
    fn a_site_proves_itself_by_a_key_of_its_name_that_may_boot() {
        let folder = tempfile::tempdir().unwrap();
        let signer = |name, role| with_key(folder.path(), name, role).signer.unwrap();
        assert_eq!(is_of(&signer("south", Role::Boot), "south"), Ok(()));
        let why = is_of(&signer("west", Role::Boot), "south").unwrap_err();
        assert!(why.contains("`south`") && why.contains("`west`"), "{why}");
        let why = is_of(&signer("north", Role::Control), "north").unwrap_err();
        assert!(why.contains("role control"), "{why}");
    }

    #[test]
    fn each_number_of_a_run_is_new_once_in_whatever_order_near_ones_come() {
        let mut numbers = Numbers::default();
        for number in [1, 3, 2, 200, 100, 199] {
            assert!(numbers.take(5, number), "{number}");
        }
        for number in [0, 1, 2, 3, 72, 100, 199, 200] {
            assert!(!numbers.take(5, number), "{number}");
        }
        assert!(numbers.take(5, 73) && numbers.take(4, 1) && numbers.take(5, u64::MAX));
        assert!(!numbers.take(5, 201) && !numbers.take(4, 1));
    }
}
