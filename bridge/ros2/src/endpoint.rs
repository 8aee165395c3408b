//! What of a publisher, a subscription or a service stands on the network: its key, its liveliness token, its GID, and what
//! is attached to its messages. Laid out as `docs/design.md` of ros2/rmw_zenoh says.

use zenoh::{key_expr::KeyExpr, session::ZenohId};

use crate::messages::RosType;

/// All tokens begin so.
const TOKENS: &str = "@ros2_lv";
/// Quality of service as a token tells it: reliable, volatile, keep the last 10, no limits of time.
const QOS: &str = "::,10:,:,:,,";

/// What an endpoint is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Publisher,
    Subscription,
    Service,
    Client,
}

impl Kind {
    const ALL: [(Self, &'static str); 4] = [
        (Self::Publisher, "MP"),
        (Self::Subscription, "MS"),
        (Self::Service, "SS"),
        (Self::Client, "SC"),
    ];

    fn code(self) -> &'static str {
        let mut all = Self::ALL.into_iter();
        all.find(|(kind, _)| *kind == self)
            .map_or("", |(_, code)| code)
    }

    /// Whether it has to do with a service, and not with a topic.
    pub fn is_service(self) -> bool {
        matches!(self, Self::Service | Self::Client)
    }
}

/// A name as a chunk of a token.
fn chunk(name: &str) -> String {
    match name {
        "" => "%".to_owned(),
        name => name.replace('/', "%"),
    }
}

/// The node of a bridge.
#[derive(Debug, Clone)]
pub(crate) struct Node {
    pub domain: u32,
    pub name: String,
    /// With a slash before it, or empty.
    pub namespace: String,
}

impl Node {
    /// A token of its endpoint `number`; it has number 0 itself.
    fn token_of(&self, session: ZenohId, number: usize, kind: &str) -> String {
        let (domain, namespace) = (self.domain, chunk(&self.namespace));
        let name = &self.name;
        // In the middle stands the enclave, of which there is none.
        format!("{TOKENS}/{domain}/{session}/0/{number}/{kind}/%/{namespace}/{name}")
    }

    /// The token by which others know that there is such a node.
    ///
    /// # Errors
    /// Its name makes no key.
    pub fn token(&self, session: ZenohId) -> Result<KeyExpr<'static>, zenoh::Error> {
        KeyExpr::try_from(self.token_of(session, 0, "NN"))
    }

    /// All tokens of the domain.
    pub fn all_tokens(&self) -> String {
        format!("{TOKENS}/{}/**", self.domain)
    }
}

/// What a token of somebody says. More parts may follow, of which nothing is known.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Token<'a> {
    /// Session and number of the node.
    pub node: (&'a str, &'a str),
    pub node_name: &'a str,
    /// None of the node's own.
    pub endpoint: Option<TokenEndpoint<'a>>,
}

/// The endpoint that a token is of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct TokenEndpoint<'a> {
    pub kind: Kind,
    pub name: String,
    pub of: &'a str,
    /// `RIHS01_` and digits; other words of ROS 2 Humble.
    pub hash: &'a str,
}

impl<'a> Token<'a> {
    /// Reads a token.
    pub fn read(token: &'a str) -> Option<Self> {
        let chunks: Vec<&str> = token.split('/').collect();
        let [
            TOKENS,
            _,
            session,
            node,
            _,
            kind,
            _,
            _,
            node_name,
            rest @ ..,
        ] = &chunks[..]
        else {
            return None;
        };
        let endpoint = match *kind {
            "NN" => None,
            code => {
                let (kind, _) = Kind::ALL.into_iter().find(|(_, known)| *known == code)?;
                let [name, of, hash, _qos, ..] = rest else {
                    return None;
                };
                Some(TokenEndpoint {
                    kind,
                    name: name.replace('%', "/"),
                    of,
                    hash,
                })
            }
        };
        Some(Self {
            node: (session, node),
            node_name,
            endpoint,
        })
    }
}

/// A publisher, a subscription or a service of a node.
#[derive(Debug, Clone)]
pub(crate) struct Endpoint {
    /// Where its messages are.
    pub key: KeyExpr<'static>,
    /// By which others know that it is there.
    pub token: KeyExpr<'static>,
    /// The XXH3-128 of the token.
    pub gid: [u8; 16],
}

impl Endpoint {
    /// The endpoint `name`, the `number`th of its session.
    ///
    /// # Errors
    /// A name makes no key.
    pub fn new(
        (node, session, number): (&Node, ZenohId, usize),
        kind: Kind,
        name: &str,
        of: RosType,
    ) -> Result<Self, zenoh::Error> {
        let RosType { name: typed, hash } = of;
        let typed = format!("{typed}/RIHS01_{hash}");
        let key = format!("{}/{}/{typed}", node.domain, name.trim_matches('/'));
        let token = node.token_of(session, number, kind.code());
        let token = format!("{token}/{}/{typed}/{QOS}", chunk(name));
        let gid = twox_hash::XxHash3_128::oneshot(token.as_bytes()).to_le_bytes();
        Ok(Self {
            key: KeyExpr::try_from(key)?,
            token: KeyExpr::try_from(token)?,
            gid,
        })
    }

    /// All keys at which something of this name may arrive, whatever its type.
    ///
    /// # Errors
    /// A name makes no key.
    pub fn any_type(&self) -> Result<KeyExpr<'static>, zenoh::Error> {
        let mut parts = self.key.rsplitn(3, '/');
        let name = parts.nth(2).unwrap_or_default();
        KeyExpr::try_from(format!("{name}/*/*"))
    }
}

/// What is attached to each message: whose it is, and the how many-th.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Attachment {
    /// From 1.
    pub sequence: i64,
    /// When it was sent, ns since 1970.
    pub at_ns: i64,
    /// The sender's.
    pub gid: [u8; 16],
}

impl Attachment {
    /// As zenoh-ext writes the three: integers in little endian, the last with its length before it.
    pub fn bytes(&self) -> [u8; 33] {
        let mut bytes = [0; 33];
        bytes[..8].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.at_ns.to_le_bytes());
        bytes[16] = 16;
        bytes[17..].copy_from_slice(&self.gid);
        bytes
    }

    /// Reads one.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let (sequence, rest) = bytes.split_first_chunk()?;
        let (at_ns, rest) = rest.split_first_chunk()?;
        let (16, gid) = rest.split_first()? else {
            return None;
        };
        Some(Self {
            sequence: i64::from_le_bytes(*sequence),
            at_ns: i64::from_le_bytes(*at_ns),
            gid: gid.try_into().ok()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{JointState, TRIGGER, Topic};

    const HASH: &str = "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e";

    fn session() -> ZenohId {
        "aac3178e146ba6f1fc6e6a4085e77f21".parse().unwrap()
    }

    fn node() -> Node {
        Node {
            domain: 2,
            name: "talker".to_owned(),
            namespace: "/robot1".to_owned(),
        }
    }

    // The layout is that of ros2/rmw_zenoh, docs/design.md.
    #[test]
    fn a_publisher_has_the_key_and_the_token_of_rmw_zenoh() {
        let (kind, name) = (Kind::Publisher, "/robot1/joint_states");
        let made = Endpoint::new((&node(), session(), 10), kind, name, JointState::TYPE).unwrap();
        let of = format!("sensor_msgs::msg::dds_::JointState_/RIHS01_{HASH}");
        assert_eq!(made.key.as_str(), format!("2/robot1/joint_states/{of}"));
        let any = made.any_type().unwrap();
        assert_eq!(any.as_str(), "2/robot1/joint_states/*/*");
        let at = "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0";
        assert_eq!(
            made.token.as_str(),
            format!("{at}/10/MP/%/%robot1/talker/%robot1%joint_states/{of}/::,10:,:,:,,")
        );
        let of_node = node().token(session()).unwrap();
        assert_eq!(of_node.as_str(), format!("{at}/0/NN/%/%robot1/talker"));
    }

    #[test]
    fn a_service_is_called_by_the_name_of_its_type_without_request() {
        let at = (&node(), session(), 1);
        let made = Endpoint::new(at, Kind::Service, "/stop", TRIGGER).unwrap();
        assert_eq!(
            made.key.as_str(),
            "2/stop/std_srvs::srv::dds_::Trigger_/RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
        );
        assert!(
            made.token
                .contains("/1/SS/%/%robot1/talker/%stop/std_srvs::srv")
        );
    }

    // Known answers of the Python package xxhash, which wraps xxHash itself.
    #[test]
    fn a_gid_is_the_hash_of_the_token_with_its_low_half_first() {
        let none = twox_hash::XxHash3_128::oneshot(b"");
        assert_eq!(none, 0x99aa_06d3_0147_98d8_6001_c324_468d_497f);
        let (kind, name) = (Kind::Publisher, "/robot1/joint_states");
        let made = Endpoint::new((&node(), session(), 10), kind, name, JointState::TYPE).unwrap();
        assert_eq!(made.token.len(), 210);
        let known: u128 = 0xc723_34a5_79be_840c_f5e3_ce34_0818_a289;
        assert_eq!(made.gid, known.to_le_bytes());
    }

    #[test]
    fn an_attachment_has_33_bytes_and_nothing_else_is_one() {
        let gid = std::array::from_fn(|at| at as u8);
        let one = Attachment {
            sequence: 1,
            at_ns: -2,
            gid,
        };
        let bytes = one.bytes();
        assert_eq!(bytes[..8], [1, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!((bytes[8], bytes[15], bytes[16]), (0xfe, 0xff, 16));
        assert_eq!(Attachment::read(&bytes), Some(one));
        for end in 0..33 {
            assert_eq!(Attachment::read(&bytes[..end]), None);
        }
        let mut longer = bytes.to_vec();
        longer.push(0);
        assert_eq!(Attachment::read(&longer), None);
        longer[16] = 17;
        assert_eq!(Attachment::read(&longer), None);
    }
}
