//! Which other nodes there are, by their liveliness tokens, and who of them cannot be understood. Knows no session.

use std::collections::{BTreeMap, BTreeSet};

use crate::{
    endpoint::{Token, TokenEndpoint},
    messages::RosType,
};

/// Of more tokens nothing is known: nobody has so many, and rubbish must not fill the memory.
const MOST: usize = 20_000;

/// An endpoint of this bridge, as others see it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Own {
    /// With the slash before it.
    pub name: String,
    pub is_service: bool,
}

/// Other nodes.
#[derive(Debug, Default)]
pub(crate) struct Graph {
    own: BTreeMap<Own, RosType>,
    /// Of each token the node, and the endpoint of ours that it fits.
    tokens: BTreeMap<String, ((String, String), Option<Own>)>,
}

/// What has changed.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Change {
    /// Somebody means one of our names by another type, in words.
    pub misfit: Option<(Own, String)>,
}

impl Graph {
    /// There is an endpoint of ours from now on.
    pub fn add(&mut self, own: Own, of: RosType) {
        self.own.insert(own, of);
    }

    /// How many other nodes there are.
    pub fn nodes(&self) -> usize {
        let nodes: BTreeSet<_> = self.tokens.values().map(|(node, _)| node).collect();
        nodes.len()
    }

    /// How many endpoints of others fit one of ours.
    pub fn peers(&self, own: &Own) -> usize {
        let fits = |(_, fits): &&(_, Option<Own>)| fits.as_ref() == Some(own);
        self.tokens.values().filter(fits).count()
    }

    /// A token of somebody has come or gone; those of our own session are none. What is no token is nobody's.
    pub fn take(&mut self, session: &str, token: &str, alive: bool) -> Change {
        let mut change = Change::default();
        if !alive {
            self.tokens.remove(token);
            return change;
        }
        let Some(Token {
            node,
            node_name,
            endpoint,
        }) = Token::read(token)
        else {
            tracing::debug!(token, "a liveliness token of nobody");
            return change;
        };
        if node.0 == session || self.tokens.len() >= MOST {
            return change;
        }
        let mut fits = None;
        if let Some(TokenEndpoint {
            kind,
            name,
            of: theirs,
            hash,
        }) = endpoint
        {
            let is_service = kind.is_service();
            let own = Own { name, is_service };
            match self.own.get(&own) {
                Some(of) if theirs == of.name && hash.strip_prefix("RIHS01_") == Some(of.hash) => {
                    fits = Some(own);
                }
                Some(of) => {
                    let text = format!(
                        "node `{node_name}` means by it {theirs} {hash}, and not {} RIHS01_{}: they exchange nothing",
                        of.name, of.hash
                    );
                    change.misfit = Some((own, text));
                }
                None => {}
            }
        }
        let node = (node.0.to_owned(), node.1.to_owned());
        self.tokens.insert(token.to_owned(), (node, fits));
        change
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{JointState, TRIGGER, Topic};

    fn own(name: &str, is_service: bool) -> Own {
        Own {
            name: name.to_owned(),
            is_service,
        }
    }

    #[test]
    fn nodes_are_counted_and_who_means_another_type_is_told() {
        let (me, other) = ("1", "2a");
        let mut graph = Graph::default();
        graph.add(own("/joint_states", false), JointState::TYPE);
        graph.add(own("/stop", true), TRIGGER);
        let of = format!("{}/RIHS01_{}", JointState::TYPE.name, JointState::TYPE.hash);
        let fits = format!("@ros2_lv/0/{other}/0/1/MS/%/%/echo/%joint_states/{of}/::,10:,:,:,,");
        assert_eq!(graph.take(me, &fits, true), Change::default());
        let mine = fits.replace("/2a/", "/1/");
        assert_eq!(graph.take(me, &mine, true), Change::default());
        assert_eq!(
            (graph.nodes(), graph.peers(&own("/joint_states", false))),
            (1, 1)
        );
        // Humble writes no hash.
        let old = format!(
            "@ros2_lv/0/3b/0/1/MS/%/%/old/%joint_states/{}/TypeHashNotSupported/::,10:,:,:,,",
            JointState::TYPE.name
        );
        let change = graph.take(me, &old, true);
        let (at, text) = change.misfit.unwrap();
        assert_eq!(at, own("/joint_states", false));
        assert!(
            text.contains("`old`") && text.contains("TypeHashNotSupported"),
            "{text}"
        );
        assert_eq!((graph.nodes(), graph.peers(&at)), (2, 1));
        graph.take(me, &fits, false);
        graph.take(me, &old, false);
        assert_eq!((graph.nodes(), graph.peers(&at)), (0, 0));
    }

    #[test]
    fn rubbish_is_nobody() {
        let me = "1";
        let mut graph = Graph::default();
        graph.add(own("/a", false), TRIGGER);
        for text in [
            "@ros2_lv/0",
            "@ros2_lv/0/2/0/0/XX/%/%/n",
            "@ros2_lv/0/2/0/0/MP/%/%/n/%a",
            "@ros2_lv/0/2/0/0/NN/%/%",
            "a/b/c",
        ] {
            assert_eq!(graph.take(me, text, true), Change::default(), "{text}");
        }
        assert_eq!(graph.nodes(), 0);
    }
}
