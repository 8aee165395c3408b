//! Meshes over a zenoh network: how the chassis find each other, and who does not get in.

use ::zenoh::{Session, Wait};

use super::*;
use ctos_link::transport;

/// An address at which nobody listens at the moment.
fn free_address() -> SocketAddr {
    let listener = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap();
    listener.local_addr().unwrap()
}

/// Somebody else's process of the network: a router or a peer that listens at `address`, no more.
fn bystander(mode: &str, address: SocketAddr) -> Session {
    let mut config = ::zenoh::Config::default();
    for (key, value) in [
        ("mode", format!("{mode:?}")),
        ("listen/endpoints", format!("[\"tcp/{address}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    std::thread::spawn(move || ::zenoh::open(config).wait().unwrap())
        .join()
        .unwrap()
}

/// zenoh refuses to be awaited on a thread of a single-threaded runtime.
fn leave(session: Session) {
    std::thread::spawn(move || session.close().wait().unwrap())
        .join()
        .unwrap();
}

async fn all_ask_all(boot: &Node, others: &[Node]) {
    let all = || others.iter().chain([boot]).map(|node| &node.chassis);
    for from in all() {
        for to in all().map(|chassis| chassis.index()) {
            if to != from.index() {
                assert_eq!(asks(from, to).await, Fault::UnknownTask);
            }
        }
    }
}

fn is_zenoh(address: &Address) -> bool {
    matches!(address, Address::Zenoh(_))
}

#[test]
fn chassis_find_each_other_by_name_through_a_router_of_the_network() {
    let address = free_address();
    let router = bystander("router", address);
    run(async {
        let connect = format!("zenoh.connect=[\"tcp/{address}\"]");
        let sets = ["same_host=zenoh", "zenoh.mode=client", &connect];
        let (boot, others) = app(3, &sets).await;
        assert!(is_zenoh(&boot.address()));
        all_ask_all(&boot, &others).await;
    });
    leave(router);
}

#[test]
fn the_boot_is_the_router_of_its_app_where_that_is_wanted() {
    run(async {
        let listen = format!("zenoh.listen=[\"tcp/{}\"]", free_address());
        let (boot, others) = app(3, &["same_host=zenoh", "zenoh.mode=router", &listen]).await;
        all_ask_all(&boot, &others).await;
    });
}

#[test]
fn peers_hear_of_each_other_from_one_that_all_know_and_then_need_it_no_more() {
    let address = free_address();
    let known = bystander("peer", address);
    run(async {
        let connect = format!("zenoh.connect=[\"tcp/{address}\"]");
        let (boot, others) = app(3, &["same_host=zenoh", &connect]).await;
        leave(known);
        all_ask_all(&boot, &others).await;
    });
}

/// Whether the loopback carries what is said to a group. In some containers it does not, and then there
/// is nothing to test.
fn has_multicast() -> std::io::Result<bool> {
    const GROUP: std::net::Ipv4Addr = std::net::Ipv4Addr::new(224, 0, 0, 225);
    let socket = std::net::UdpSocket::bind((GROUP, 0))?;
    let at = (GROUP, socket.local_addr()?.port());
    socket.join_multicast_v4(&GROUP, &std::net::Ipv4Addr::LOCALHOST)?;
    rustix::net::sockopt::set_ip_multicast_if(&socket, &std::net::Ipv4Addr::LOCALHOST)?;
    socket.set_read_timeout(Some(Duration::from_secs(1)))?;
    socket.send_to(b"anybody", at)?;
    Ok(socket.recv(&mut [0; 7])? == 7)
}

#[test]
fn chassis_find_each_other_by_multicast_on_the_loopback() {
    if !has_multicast().unwrap_or(false) {
        return;
    }
    run(async {
        let (boot, others) = app(3, &["same_host=zenoh", "zenoh.multicast=lo"]).await;
        all_ask_all(&boot, &others).await;
    });
}

#[test]
fn chassis_of_one_host_stay_with_shared_memory_while_others_could_come_by_zenoh() {
    run(async {
        let (boot, others) = app(2, &["zenoh.multicast=lo"]).await;
        assert!(matches!(
            boot.mesh.addresses(),
            [Address::Unix(_), Address::Zenoh(_)]
        ));
        all_ask_all(&boot, &others).await;
    });
}

#[test]
fn a_chassis_of_another_host_is_called_by_zenoh_when_it_has_no_other_address() {
    run(async {
        let listen = format!("zenoh.listen=[\"tcp/{}\"]", free_address());
        let sets = ["zenoh.mode=router", &listen];
        let mut boot = Node::boot(2, &sets).await;
        let mut others = Vec::new();
        for index in [1, 2] {
            let chassis = chassis(index, &sets);
            let (token, incarnation) = (token(), 1);
            let who = Identification { token, incarnation };
            let process = Process {
                host: format!("host {index}"),
                pid: 1,
            };
            let mesh = Mesh::start_as(&chassis, who, process).await.unwrap();
            others.push(Node { chassis, mesh });
        }
        let address = boot
            .mesh
            .addresses()
            .iter()
            .find(|address| is_zenoh(address));
        for node in &others {
            node.mesh.join(address.unwrap());
        }
        boot.joined_by(&[1, 2]).await;
        for node in &mut others {
            node.joined_by(&[node.chassis.index()]).await;
        }
        all_ask_all(&boot, &others).await;
    });
}

#[test]
fn a_link_outlives_the_router_that_carried_it() {
    let address = free_address();
    let router = bystander("router", address);
    run(async {
        let connect = format!("zenoh.connect=[\"tcp/{address}\"]");
        let sets = [
            "same_host=zenoh",
            "zenoh.mode=client",
            "peer_timeout_s=60",
            &connect,
        ];
        let (boot, others) = app(2, &sets).await;
        leave(router);
        let call = asks(&others[0].chassis, 2);
        let again = async {
            tokio::task::spawn_blocking(move || bystander("router", address))
                .await
                .unwrap()
        };
        let (fault, router) = tokio::join!(call, again);
        assert_eq!(fault, Fault::UnknownTask);
        all_ask_all(&boot, &others).await;
        leave(router);
    });
}

#[test]
fn keys_are_proved_from_end_to_end_and_nobody_talks_to_strangers() {
    let folder = tempfile::tempdir().unwrap();
    let keys = folder.path().join("keys");
    make_key(&keys.join("cell"), Role::Boot).unwrap();
    make_key(&keys.join("viewer"), Role::Watch).unwrap();
    let strange = folder.path().join("strange");
    make_key(&strange.join("cell"), Role::Boot).unwrap();
    let security = |folder: &Path, name: &str| {
        let (key, authority) = (folder.join(name), folder.join("ca.pem"));
        format!("security={{ key = {key:?}, authority = {authority:?} }}")
    };
    run(async {
        let listen = format!("zenoh.listen=[\"tcp/{}\"]", free_address());
        let with = |security: &str| {
            let sets = [
                "same_host=zenoh",
                "zenoh.mode=router",
                "phase_timeout_s=2",
                &listen,
                security,
            ];
            sets.map(str::to_owned)
        };
        let sets = with(&security(&keys, "cell"));
        let sets = sets.each_ref().map(String::as_str);
        let (mut boot, others) = app(2, &sets).await;
        all_ask_all(&boot, &others).await;
        // Every program that reaches it may join the network; a chassis needs a key with the role
        // for it.
        let viewer = with(&security(&keys, "viewer"));
        let viewer = Node::start(1, 2, &viewer.each_ref().map(String::as_str)).await;
        viewer.mesh.join(&boot.address());
        let inner = &viewer.mesh.inner;
        let called =
            transport::connect(&boot.address(), inner.keys.as_ref(), inner.fabric.as_ref()).await;
        let (mut stream, identity) = called.unwrap();
        assert_eq!(identity.unwrap().role, Role::Boot);
        say_hello(&mut stream, hello(1, 2)).await;
        assert!(hear::<Answer>(&mut stream).await.is_err());
        assert!(boot.mesh.refused() > 0);
        // Without keys, over the same network: nobody talks to it.
        let bare = transport::connect(&boot.address(), None, inner.fabric.as_ref()).await;
        let mut bare = bare.unwrap().0;
        say_hello(&mut bare, hello(1, 2)).await;
        assert!(hear::<Answer>(&mut bare).await.is_err());
        // Nor to keys of another authority.
        let stranger = with(&security(&strange, "cell"));
        let stranger = Node::start(1, 2, &stranger.each_ref().map(String::as_str)).await;
        let inner = &stranger.mesh.inner;
        let called =
            transport::connect(&boot.address(), inner.keys.as_ref(), inner.fabric.as_ref()).await;
        assert!(called.is_err());
        all_ask_all(&boot, &others).await;
        boot.mesh.close().await;
    });
}
