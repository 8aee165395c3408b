//! Names of service objects (SORMA technical report, section 1.4.3).

use ctos::diagnostic::Finding;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// `class[.flavor][@daemon]`, or `CLASS[.flavor]` for the class's default daemon.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ObjectName {
    class: String,
    flavor: Option<String>,
    at: Location,
}

/// Which process serves an object.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Location {
    /// Nothing was said: this process.
    Local,
    /// `@self`: this process, said aloud.
    Here,
    /// The upper-case form: the daemon that the dictionary names for the class.
    Default,
    /// `@alias`: the dictionary says which daemon that is.
    Alias(String),
    /// `@host:number`: a daemon by its address.
    Address {
        /// Host name or IPv4 address.
        host: String,
        /// Number of the daemon on that host.
        number: u32,
    },
}

/// Why a text is not a name.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum NameError {
    /// The class part is empty or has other characters.
    #[error("`{0}`: a class name begins with a letter and goes on with letters, digits or `_`")]
    Class(String),
    /// The flavor part is empty or has other characters.
    #[error("`{0}`: a flavor has letters, digits, `_`, `-` and `.`, at least one")]
    Flavor(String),
    /// The part after `@` is neither an alias nor `host:number`.
    #[error("`{0}`: after `@` stands `self`, a daemon's alias, or host:number")]
    Daemon(String),
    /// Upper case and `@` at once.
    #[error(
        "`{0}`: an upper-case class means its default daemon, so no `@` may follow; \
         write the class in lower case or leave out the `@` part"
    )]
    TwoDaemons(String),
}

impl ObjectName {
    /// The class, in the spelling it is registered under.
    #[must_use]
    pub fn class(&self) -> &str {
        &self.class
    }

    /// The flavor.
    #[must_use]
    pub fn flavor(&self) -> Option<&str> {
        self.flavor.as_deref()
    }

    /// Who serves it.
    #[must_use]
    pub fn location(&self) -> &Location {
        &self.at
    }

    /// The same object, as the process that serves it names it.
    #[must_use]
    pub fn here(&self) -> Self {
        Self {
            at: Location::Local,
            ..self.clone()
        }
    }

    /// `class[.flavor]`: its name in the process that serves it, and in that dictionary.
    #[must_use]
    pub fn local(&self) -> String {
        match &self.flavor {
            Some(flavor) => format!("{}.{flavor}", self.class),
            None => self.class.clone(),
        }
    }
}

impl FromStr for ObjectName {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        let (path, daemon) = match text.split_once('@') {
            Some((path, daemon)) => (path, Some(daemon)),
            None => (text, None),
        };
        let (class, flavor) = match path.split_once('.') {
            Some((class, flavor)) => (class, Some(flavor)),
            None => (path, None),
        };
        if !is_class(class) {
            return Err(NameError::Class(text.to_owned()));
        }
        if flavor.is_some_and(|flavor| !is_plain(flavor)) {
            return Err(NameError::Flavor(text.to_owned()));
        }
        let upper = !class.bytes().any(|letter| letter.is_ascii_lowercase());
        let at = match (upper, daemon) {
            (true, Some(_)) => return Err(NameError::TwoDaemons(text.to_owned())),
            (true, None) => Location::Default,
            (false, None) => Location::Local,
            (false, Some(daemon)) => {
                Location::parse(daemon).ok_or_else(|| NameError::Daemon(text.to_owned()))?
            }
        };
        Ok(Self {
            class: if upper {
                class.to_ascii_lowercase()
            } else {
                class.to_owned()
            },
            flavor: flavor.map(str::to_owned),
            at,
        })
    }
}

impl Location {
    /// Reads what stands after `@`. The number may be hexadecimal (`druide:0x14`).
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        if text == "self" {
            return Some(Self::Here);
        }
        let Some((host, number)) = text.rsplit_once(':') else {
            // A daemon at another site is `DAEMON@SITE`.
            let (daemon, site) = text.split_once('@').unwrap_or((text, "here"));
            return (is_plain(daemon) && is_plain(site)).then(|| Self::Alias(text.to_owned()));
        };
        let digits = |text: &str, radix| {
            let plain = text.bytes().all(|digit| digit.is_ascii_hexdigit());
            u32::from_str_radix(text, radix).ok().filter(|_| plain)
        };
        let number = match number.strip_prefix("0x") {
            Some(hex) => digits(hex, 16)?,
            None => digits(number, 10)?,
        };
        is_plain(host).then(|| Self::Address {
            host: host.to_owned(),
            number,
        })
    }
}

fn is_class(text: &str) -> bool {
    text.starts_with(|first: char| first.is_ascii_alphabetic())
        && text
            .bytes()
            .all(|letter| letter.is_ascii_alphanumeric() || letter == b'_')
}

fn is_plain(text: &str) -> bool {
    let plain = |letter: u8| letter.is_ascii_alphanumeric() || b"_-.".contains(&letter);
    !text.is_empty() && text.bytes().all(plain)
}

impl fmt::Display for ObjectName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.at {
            Location::Default => f.write_str(&self.class.to_ascii_uppercase())?,
            _ => f.write_str(&self.class)?,
        }
        if let Some(flavor) = &self.flavor {
            write!(f, ".{flavor}")?;
        }
        match &self.at {
            Location::Local | Location::Default => Ok(()),
            Location::Here => f.write_str("@self"),
            Location::Alias(alias) => write!(f, "@{alias}"),
            Location::Address { host, number } => write!(f, "@{host}:{number}"),
        }
    }
}

/// "did you mean" in one sentence, for reports.
pub fn suggestion<'a>(given: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    // Nothing known is as long as this, and a text of any length must not cost any time.
    const LONGEST: usize = 200;
    if given.len() > LONGEST {
        return String::new();
    }
    // As a trait object, so that the search is compiled once.
    let mut known = known.into_iter();
    let known: &mut dyn Iterator<Item = &str> = &mut known;
    let finding = Finding::error("sorma", "").suggest(given, known);
    finding
        .help
        .map(|help| format!("; {help}"))
        .unwrap_or_default()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(crate) fn any_name() -> impl Strategy<Value = ObjectName> {
        let location = prop_oneof![
            Just(String::new()),
            Just("@self".to_owned()),
            "@[a-z0-9_.-]{1,8}(@[a-z0-9_.-]{1,8})?",
            ("[a-z0-9.-]{1,8}", any::<u32>())
                .prop_map(|(host, number)| format!("@{host}:{number}")),
        ];
        let local = ("[a-z][a-zA-Z0-9_]{0,8}(\\.[a-zA-Z0-9_.-]{1,8})?", location)
            .prop_map(|(path, location)| path + &location);
        prop_oneof![local, "[A-Z][A-Z0-9_]{0,8}(\\.[a-zA-Z0-9_.-]{1,8})?"]
            .prop_map(|text| text.parse().unwrap())
    }

    #[test]
    fn the_four_forms_of_the_report_are_told_apart() {
        let at = |text: &str| text.parse::<ObjectName>().unwrap();
        assert_eq!(at("foo.a").location(), &Location::Local);
        let address = at("foo.a@druide:11");
        assert_eq!(
            address.location(),
            &Location::Address {
                host: "druide".to_owned(),
                number: 11
            }
        );
        assert_eq!(at("carry@druide:0x14").to_string(), "carry@druide:20");
        assert_eq!(at("foo.a@d1").location(), &Location::Alias("d1".to_owned()));
        let abroad = at("foo.a@d1@north");
        assert_eq!(abroad.location(), &Location::Alias("d1@north".to_owned()));
        assert_eq!(abroad.to_string(), "foo.a@d1@north");
        let default = at("FOO.a");
        assert_eq!(
            (default.class(), default.location()),
            ("foo", &Location::Default)
        );
        assert_eq!(default.local(), "foo.a");
        assert_eq!(at("bar@self").location(), &Location::Here);
    }

    #[test]
    fn what_is_no_name_is_refused_with_the_rule() {
        let wrong = |text: &str| text.parse::<ObjectName>().unwrap_err();
        assert!(matches!(wrong(""), NameError::Class(_)));
        assert!(matches!(wrong("1a"), NameError::Class(_)));
        assert!(matches!(wrong("é"), NameError::Class(_)));
        assert!(matches!(wrong("foo."), NameError::Flavor(_)));
        assert!(matches!(wrong("foo.a b"), NameError::Flavor(_)));
        for daemon in [
            "foo@",
            "foo@:1",
            "foo@h:",
            "foo@h:+1",
            "foo@h:0x",
            "foo@h:4294967296",
            "foo@a@",
            "foo@@b",
            "foo@a@b@c",
            "foo@a@b:1",
        ] {
            assert!(matches!(wrong(daemon), NameError::Daemon(_)), "{daemon}");
        }
        assert!(matches!(wrong("FOO@d1"), NameError::TwoDaemons(_)));
    }

    proptest! {
        #[test]
        fn a_name_is_read_back_from_its_text(name in any_name()) {
            prop_assert_eq!(name.to_string().parse::<ObjectName>().unwrap(), name);
        }

        #[test]
        fn any_text_is_a_name_or_is_refused(text in any::<String>()) {
            if let Ok(name) = text.parse::<ObjectName>() {
                prop_assert_eq!(name.to_string().parse::<ObjectName>().unwrap(), name);
            }
        }
    }
}
