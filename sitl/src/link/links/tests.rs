use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

use super::*;

const OPTIONS: LinkOptions =
    LinkOptions { backlog: Backlog::Close(1 << 20), connects_later: false, max_streams: 16, udp_peers: None };
const PATIENCE: Duration = Duration::from_secs(30);

async fn open(text: &str, options: LinkOptions) -> Links {
    Links::open(&[text.parse().unwrap()], options).await.unwrap()
}

fn address(links: &Links, index: usize) -> SocketAddr {
    links.name(index).split_once(':').unwrap().1.parse().unwrap()
}

async fn next(links: &mut Links, buffer: &mut [u8]) -> Arrival {
    timeout(PATIENCE, links.receive(buffer)).await.unwrap()
}

/// The peer of the next stream.
async fn connected(links: &mut Links) -> PeerId {
    match next(links, &mut [0; 16]).await {
        Arrival::Connected(peer) => peer,
        other => panic!("{other:?} instead of a stream"),
    }
}

#[tokio::test]
async fn each_peer_is_answered_at_its_own_address_and_endpoint() {
    let endpoints = ["udpin:127.0.0.1:0", "udpin:127.0.0.1:0", "tcpin:127.0.0.1:0"];
    let endpoints: Vec<Endpoint> = endpoints.iter().map(|text| text.parse().unwrap()).collect();
    let mut links = Links::open(&endpoints, OPTIONS).await.unwrap();
    let mut buffer = vec![0; BUFFER];
    let peers =
        [UdpSocket::bind("127.0.0.1:0").await.unwrap(), UdpSocket::bind("127.0.0.1:0").await.unwrap()];
    for (k, peer) in peers.iter().enumerate() {
        peer.send_to(b"hello", address(&links, k)).await.unwrap();
        let Arrival::Bytes(from, 5) = next(&mut links, &mut buffer).await else { panic!("a datagram") };
        assert_eq!((from.endpoint, from.address), (k, peer.local_addr().unwrap()));
        links.send(from, b"you").unwrap();
        assert_eq!(links.flush().await, []);
        let mut answer = [0; 9];
        assert_eq!(peer.recv(&mut answer).await.unwrap(), 3);
    }
    let mut stream = TcpStream::connect(address(&links, 2)).await.unwrap();
    let from = connected(&mut links).await;
    links.send(from, b"first").unwrap();
    let mut answer = [0; 5];
    // What a new stream could not take at once is written while something else is waited for.
    tokio::select! {
        read = stream.read_exact(&mut answer) => drop(read.unwrap()),
        other = links.receive(&mut buffer) => panic!("{other:?}"),
    }
    stream.write_all(b"hello").await.unwrap();
    assert_eq!(next(&mut links, &mut buffer).await, Arrival::Bytes(from, 5));
    drop(stream);
    assert_eq!(next(&mut links, &mut buffer).await, Arrival::Closed(from));
    assert!(matches!(links.send(from, b"gone"), Err(SendError::Gone)));
    let sent = |count, bytes| LinkCounters { sent: count, sent_bytes: bytes, full: 0, failed: 0 };
    assert_eq!(links.counters(), [sent(1, 3), sent(1, 3), sent(1, 5)]);
}

#[tokio::test]
async fn a_stream_outward_connects_again() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let mut links = open(&format!("tcp:{}", listener.local_addr().unwrap()), OPTIONS).await;
    let mut buffer = vec![0; BUFFER];
    for _ in 0..2 {
        let peer = connected(&mut links).await;
        let (mut stream, _) = listener.accept().await.unwrap();
        links.send(peer, b"x").unwrap();
        assert_eq!(stream.read_u8().await.unwrap(), b'x');
        drop(stream);
        assert_eq!(next(&mut links, &mut buffer).await, Arrival::Closed(peer));
    }
}

#[tokio::test]
async fn a_stream_outward_may_wait_for_its_listener() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let text = format!("tcp:{}", listener.local_addr().unwrap());
    drop(listener);
    let mut links = open(&text, LinkOptions { connects_later: true, ..OPTIONS }).await;
    assert!(
        timeout(Duration::from_millis(50), links.receive(&mut [0; 16])).await.is_err(),
        "nobody is there"
    );
    let listener = TcpListener::bind(text.strip_prefix("tcp:").unwrap()).await.unwrap();
    let peer = connected(&mut links).await;
    let (mut stream, _) = listener.accept().await.unwrap();
    links.send(peer, b"x").unwrap();
    assert_eq!(stream.read_u8().await.unwrap(), b'x');
}

#[tokio::test]
async fn a_peer_that_does_not_read_is_closed_and_its_end_is_told() {
    let mut links = open("tcpin:127.0.0.1:0", OPTIONS).await;
    let _deaf = TcpStream::connect(address(&links, 0)).await.unwrap();
    let peer = connected(&mut links).await;
    let full = (0..20_000).find_map(|_| links.send(peer, &[0; 1000]).err());
    assert!(matches!(full, Some(SendError::Full(waiting)) if waiting > 1 << 19), "{full:?}");
    assert_eq!(next(&mut links, &mut [0; 16]).await, Arrival::Closed(peer));
    assert!(matches!(links.send(peer, b"x"), Err(SendError::Gone)));
    assert_eq!(links.counters()[0].full, 1);
}

/// The other policy: the stream lives, hears whole messages alone, and what it missed is counted.
#[tokio::test]
async fn a_peer_that_reads_slowly_misses_whole_messages_and_they_are_counted() {
    const LENGTH: usize = 1000;
    let options = LinkOptions { backlog: Backlog::Drop(1 << 16), ..OPTIONS };
    let mut links = open("tcpin:127.0.0.1:0", options).await;
    let mut slow = TcpStream::connect(address(&links, 0)).await.unwrap();
    let peer = connected(&mut links).await;
    let message = |k: usize| vec![k as u8; LENGTH];
    let mut sent: Vec<u8> = Vec::new();
    for k in 0..20_000 {
        if links.send(peer, &message(k)).is_ok() {
            sent.push(k as u8);
        }
    }
    let LinkCounters { sent: count, full, failed, .. } = links.counters()[0];
    assert_eq!((count as usize, count + full, failed), (sent.len(), 20_000, 0));
    assert!(full > 0, "the system holds it all");
    let reader = tokio::spawn(async move {
        let mut bytes = Vec::new();
        slow.read_to_end(&mut bytes).await.unwrap();
        bytes
    });
    // What waits is written at the end.
    links.close().await;
    drop(links);
    let bytes = reader.await.unwrap();
    assert_eq!(bytes.len(), sent.len() * LENGTH);
    for (chunk, k) in bytes.chunks(LENGTH).zip(sent) {
        assert!(chunk.iter().all(|byte| *byte == k), "a message was parted");
    }
}

#[tokio::test]
async fn a_flood_on_one_stream_starves_no_other() {
    let mut links = open("tcpin:127.0.0.1:0", OPTIONS).await;
    let mut streams = Vec::new();
    let mut peers = Vec::new();
    for _ in 0..3 {
        streams.push(TcpStream::connect(address(&links, 0)).await.unwrap());
        peers.push(connected(&mut links).await);
    }
    for stream in &mut streams {
        stream.write_all(&[7; 50]).await.unwrap();
    }
    // Each is asked for ten bytes at a time, and each comes once in three.
    let mut heard = Vec::new();
    for _ in 0..9 {
        let Arrival::Bytes(from, 10) = next(&mut links, &mut [0; 10]).await else { panic!("bytes") };
        heard.push(from);
    }
    for turn in heard.chunks(3) {
        assert!(peers.iter().all(|peer| turn.contains(peer)), "{heard:?}");
    }
}

#[tokio::test]
async fn streams_beyond_the_limit_are_closed_at_once() {
    let mut links = open("tcpin:127.0.0.1:0", LinkOptions { max_streams: 1, ..OPTIONS }).await;
    let _first = TcpStream::connect(address(&links, 0)).await.unwrap();
    connected(&mut links).await;
    let mut second = TcpStream::connect(address(&links, 0)).await.unwrap();
    let mut buffer = [0; 16];
    let mut received = [0; 16];
    tokio::select! {
        read = second.read(&mut buffer) => assert_eq!(read.unwrap_or(0), 0),
        other = links.receive(&mut received) => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn a_silent_udp_peer_is_told_to_be_gone() {
    let peers = UdpPeers { most: 64, silence: Duration::from_millis(200) };
    let mut links = open("udpin:127.0.0.1:0", LinkOptions { udp_peers: Some(peers), ..OPTIONS }).await;
    let (silent, talker) =
        (UdpSocket::bind("127.0.0.1:0").await.unwrap(), UdpSocket::bind("127.0.0.1:0").await.unwrap());
    silent.send_to(b"once", address(&links, 0)).await.unwrap();
    let Arrival::Bytes(silent, 4) = next(&mut links, &mut [0; 16]).await else { panic!("a datagram") };
    let to = address(&links, 0);
    let talk = async {
        loop {
            talker.send_to(b"again", to).await.unwrap();
            sleep(Duration::from_millis(20)).await;
        }
    };
    let gone = async {
        let mut heard = 0;
        loop {
            match next(&mut links, &mut [0; 16]).await {
                Arrival::Closed(peer) => return (peer, heard),
                Arrival::Bytes(..) => heard += 1,
                other => panic!("{other:?}"),
            }
        }
    };
    let (peer, heard) = tokio::select! {
        () = talk => unreachable!(),
        gone = gone => gone,
    };
    assert_eq!(peer, silent);
    assert!(heard > 0, "who speaks stays");
}

#[tokio::test]
async fn the_udp_peer_silent_for_longest_makes_room() {
    let peers = UdpPeers { most: 2, silence: Duration::from_secs(60) };
    let mut links = open("udpin:127.0.0.1:0", LinkOptions { udp_peers: Some(peers), ..OPTIONS }).await;
    let mut sockets = Vec::new();
    for _ in 0..3 {
        sockets.push(UdpSocket::bind("127.0.0.1:0").await.unwrap());
    }
    let mut peers = Vec::new();
    for k in [0, 1, 0, 2] {
        sockets[k].send_to(b"here", address(&links, 0)).await.unwrap();
        let Arrival::Bytes(peer, 4) = next(&mut links, &mut [0; 16]).await else { panic!("a datagram") };
        peers.push(peer);
    }
    assert_eq!(next(&mut links, &mut [0; 16]).await, Arrival::Closed(peers[1]));
}

#[tokio::test]
async fn a_burst_is_given_from_all_endpoints_in_turn() {
    let endpoints = ["udpin:127.0.0.1:0", "udpin:127.0.0.1:0"].map(|text| text.parse().unwrap());
    let mut links = Links::open(&endpoints, OPTIONS).await.unwrap();
    let peer = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    for k in [0, 0, 0, 1, 1, 1] {
        peer.send_to(b"x", address(&links, k)).await.unwrap();
    }
    let mut buffer = [0; 16];
    let Arrival::Bytes(first, _) = next(&mut links, &mut buffer).await else { panic!("a datagram") };
    let mut heard = vec![first.endpoint];
    while let Some(Arrival::Bytes(from, _)) = links.try_receive(&mut buffer) {
        heard.push(from.endpoint);
    }
    assert_eq!(heard, [0, 1, 0, 1, 0, 1]);
}

#[tokio::test]
async fn what_cannot_be_opened_is_said_in_one_line() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let taken = listener.local_addr().unwrap();
    let error =
        async |text: String| Links::open(&[text.parse().unwrap()], OPTIONS).await.unwrap_err().to_string();
    let tcp = error(format!("tcpin:{taken}")).await;
    assert!(tcp.starts_with(&format!("tcpin:{taken}: binding")) && tcp.contains("in use"), "{tcp}");
    drop(listener);
    let refused = error(format!("tcp:{taken}")).await;
    assert!(
        refused.starts_with(&format!("tcpout:{taken}: connecting")) && !refused.contains('\n'),
        "{refused}"
    );
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let taken = socket.local_addr().unwrap();
    let udp = error(format!("udpin:{taken}")).await;
    assert!(udp.contains(&format!("binding {taken}")) && udp.contains("in use"), "{udp}");
}
