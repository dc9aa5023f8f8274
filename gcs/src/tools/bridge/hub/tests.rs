use crpl_sitl::link::dialect;
use crpl_sitl::link::encoder::Encoder;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::time::timeout;

use super::*;

const PATIENCE: Duration = Duration::from_secs(30);

fn heartbeat(encoder: &mut Encoder) -> Vec<u8> {
    let mut out = Vec::new();
    encoder.push(&mut out, &dialect::HEARTBEAT_DATA::default());
    out
}

/// Opens an endpoint; gives the address that it printed.
async fn open(hub: &mut Hub, endpoint: &str) -> String {
    let shown = hub.open(&endpoint.parse().unwrap()).await.unwrap();
    shown.split_once("in:").map_or(shown.clone(), |(_, address)| address.to_owned())
}

/// Routes in the background for ever.
fn run(mut hub: Hub) {
    tokio::spawn(async move {
        loop {
            hub.turn().await;
        }
    });
}

async fn udp(to: &str) -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    socket.connect(to).await.unwrap();
    socket
}

#[tokio::test]
async fn udp_and_tcp_peers_hear_each_other() {
    let mut hub = Hub::default();
    let datagrams = open(&mut hub, "udpin:127.0.0.1:0").await;
    let streams = open(&mut hub, "tcpin:127.0.0.1:0").await;
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    open(&mut hub, &format!("tcpout:{}", listener.local_addr().unwrap())).await;
    run(hub);

    let story = async {
        let (mut server, _) = listener.accept().await.unwrap();
        let mut client = TcpStream::connect(&streams).await.unwrap();
        let (mut first, mut second) = (Encoder::new(1, 1), Encoder::new(2, 1));
        // A connection is known to the hub once something of it has come out elsewhere.
        let peer = udp(&datagrams).await;
        peer.send(&heartbeat(&mut first)).await.unwrap();
        let hello = heartbeat(&mut second);
        client.write_all(&hello[..5]).await.unwrap();
        client.write_all(&hello[5..]).await.unwrap();
        let mut buffer = vec![0; 1500];
        let length = peer.recv(&mut buffer).await.unwrap();
        assert_eq!(buffer[..length], hello, "a frame in two segments");

        let frame = heartbeat(&mut first);
        peer.send(&[b"junk", &frame[..]].concat()).await.unwrap();
        for stream in [&mut client, &mut server] {
            let (mut heard, mut buffer) = (Vec::new(), [0; 64]);
            while !heard.ends_with(&frame) {
                let length = stream.read(&mut buffer).await.unwrap();
                assert!(length > 0, "the stream ended");
                heard.extend_from_slice(&buffer[..length]);
            }
        }
    };
    timeout(PATIENCE, story).await.unwrap();
}

#[tokio::test]
async fn a_connection_that_ends_is_made_again() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let mut hub = Hub::default();
    let datagrams = open(&mut hub, "udpin:127.0.0.1:0").await;
    open(&mut hub, &format!("tcpout:{}", listener.local_addr().unwrap())).await;
    run(hub);
    let story = async {
        drop(listener.accept().await.unwrap());
        let (mut server, _) = listener.accept().await.unwrap();
        let (peer, mut encoder) = (udp(&datagrams).await, Encoder::new(1, 1));
        // The hub learns of the connection in its own time.
        let mut byte = [0];
        loop {
            peer.send(&heartbeat(&mut encoder)).await.unwrap();
            if timeout(Duration::from_millis(50), server.read_exact(&mut byte)).await.is_ok() {
                break;
            }
        }
        assert_eq!(byte, [0xFD]);
    };
    timeout(PATIENCE, story).await.unwrap();
}

#[tokio::test]
async fn a_program_with_a_link_of_its_own_hears_and_is_heard() {
    let mut hub = Hub::default();
    let address = open(&mut hub, "udpin:127.0.0.1:0").await;
    let story = async {
        let (peer, mut encoder) = (udp(&address).await, Encoder::new(1, 1));
        let hello = heartbeat(&mut encoder);
        hub.local();
        peer.send(&hello).await.unwrap();
        while hub.router().links().count() < 2 {
            hub.turn().await;
        }
        assert_eq!(hub.take(), Some(hello));
        let ours = heartbeat(&mut Encoder::new(255, 190));
        hub.send(&ours).await;
        let mut buffer = vec![0; 1500];
        let length = peer.recv(&mut buffer).await.unwrap();
        assert_eq!(buffer[..length], ours);
    };
    timeout(PATIENCE, story).await.unwrap();
}
