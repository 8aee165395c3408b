//! What all listeners have in common: how many strangers they hear and for how long, and their
//! answer to browsers. Also how often they log refusals, the secrets of their ports, and how pages
//! are served.
//!
//! Knows nothing of what is said to a caller who has shown who it is.

mod lobby;
mod pages;
mod secret;

pub use ctos_bootstrap::refusals::Refusals;
pub(crate) use ctos_link::transport::{NO_PAGE, is_http};
pub(crate) use lobby::{Lobby, Turned};
pub use pages::{OpenError, Pages};
pub use secret::{PortSecret, Secret, SecretError, private_file};

/// How many callers who have not shown who they are a port hears at a time.
pub(crate) const STRANGERS: usize = 64;

/// How long a caller may take to show who it is.
pub(crate) const STRANGER_TIMEOUT: std::time::Duration = std::time::Duration::from_secs(5);

/// How long to wait after an `accept` that failed: no file descriptors for the moment, perhaps.
pub(crate) const ACCEPT_PAUSE: std::time::Duration = std::time::Duration::from_millis(20);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_browser_begins_with_is_http_and_what_our_tools_begin_with_is_not() {
        for said in [
            "POST / HTTP/1.1\r\nHost: localhost",
            "GET /",
            "OPTIONS * HTTP/1.1",
            "host: evil.example",
            "PRI * HTTP/2.0\r\n",
        ] {
            assert!(is_http(said.as_bytes()), "{said}");
        }
        for said in [
            &b"ctos\0\0\0\x05"[..],
            b"ctosagt\0",
            b"{\"token\":\"GET HTTP\"}",
            b"\x16\x03\x01",
            b"",
        ] {
            assert!(!is_http(said), "{said:?}");
        }
    }

    /// All Rust below a folder, in one text.
    fn code(folder: &std::path::Path, into: &mut String) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                code(&path, into);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                into.push_str(&std::fs::read_to_string(&path).unwrap());
            }
        }
    }

    #[test]
    fn every_port_of_the_page_on_security_has_tests_that_there_are() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let mut tests = String::new();
        for folder in ["ctos", "cli", "tests/system"] {
            code(&root.join(folder), &mut tests);
        }
        let page = include_str!("../../../docs/security.md");
        let (_, section) = page.split_once("\n## Every port\n").unwrap();
        let (section, _) = section.split_once("\n## Keys\n").unwrap();
        let named = |text: &str| -> Vec<String> {
            let words = text.split('`').skip(1).step_by(2);
            let words = words.filter(|word| word.matches('_').count() > 2);
            words.map(str::to_owned).collect()
        };
        let rows = section.lines().filter(|line| line.starts_with("| "));
        let rows: Vec<&str> = rows.skip(1).collect();
        assert!(rows.len() > 10, "the table is gone");
        for row in rows {
            assert!(!named(row).is_empty(), "no test: {row}");
        }
        for name in named(section) {
            let there = tests.contains(&format!("fn {name}("));
            assert!(there, "there is no test `{name}`");
        }
    }

    #[test]
    fn the_refusal_is_as_long_as_it_says() {
        let (head, body) = NO_PAGE.split_once("\r\n\r\n").unwrap();
        assert!(head.contains(&format!("Content-Length: {}\r\n", body.len())));
    }
}
