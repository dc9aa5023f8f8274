//! `GET /metrics` over HTTP/1.1, which is all that Prometheus asks for, and HEAD. Any other path is 404, any
//! other method 405; a client that sends too much or too slowly is dropped.

use std::net::SocketAddr;
use std::time::Duration;

use anyhow::{Context, Result};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{mpsc, oneshot};
use tokio::time::timeout;

/// A request for the text; the answer goes into it.
pub type Scrape = oneshot::Sender<String>;

/// Longest request head.
const HEAD: usize = 8192;
/// How long a client may take.
const PATIENCE: Duration = Duration::from_secs(5);

/// Listens on `address`; gives the address with the port that the system chose, and the requests.
///
/// # Errors
/// The address cannot be bound.
pub async fn listen(address: SocketAddr) -> Result<(SocketAddr, mpsc::Receiver<Scrape>)> {
    let listener = TcpListener::bind(address).await.with_context(|| format!("--metrics {address}"))?;
    let local = listener.local_addr().context("reading the address of --metrics")?;
    let (sender, receiver) = mpsc::channel(8);
    tokio::spawn(async move {
        while !sender.is_closed() {
            match listener.accept().await {
                Ok((stream, _)) => {
                    let sender = sender.clone();
                    tokio::spawn(async move {
                        if let Ok(Err(error)) = timeout(PATIENCE, answer(stream, &sender)).await {
                            tracing::debug!("metrics: {error}");
                        }
                    });
                }
                Err(error) => {
                    tracing::warn!("metrics: {error}");
                    tokio::time::sleep(Duration::from_secs(1)).await;
                }
            }
        }
    });
    Ok((local, receiver))
}

async fn answer(mut stream: TcpStream, sender: &mpsc::Sender<Scrape>) -> Result<()> {
    let mut head = Vec::new();
    let mut chunk = [0; 1024];
    while !head.windows(4).any(|end| end == b"\r\n\r\n") {
        let length = stream.read(&mut chunk).await?;
        if length == 0 || head.len() > HEAD {
            return Ok(());
        }
        head.extend_from_slice(&chunk[..length]);
    }
    let line = head.split(|&byte| byte == b'\r').next().unwrap_or_default();
    let line = String::from_utf8_lossy(line);
    let mut words = line.split(' ');
    let (method, path) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let (status, body) = match (method, path.split('?').next()) {
        ("GET" | "HEAD", Some("/metrics")) => {
            let (reply, text) = oneshot::channel();
            sender.send(reply).await?;
            ("200 OK", text.await?)
        }
        ("GET" | "HEAD", _) => ("404 Not Found", "try /metrics\n".to_owned()),
        _ => ("405 Method Not Allowed", "GET only\n".to_owned()),
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; version=0.0.4\r\nContent-Length: {}\r\n\
         Connection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes()).await?;
    if method != "HEAD" {
        stream.write_all(body.as_bytes()).await?;
    }
    stream.shutdown().await?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn get(address: SocketAddr, request: &str) -> String {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut text = String::new();
        // Whoever is dropped in the middle of his request finds the connection reset.
        let _ = stream.read_to_string(&mut text).await;
        text
    }

    #[tokio::test]
    async fn metrics_are_served_and_nothing_else() {
        let (address, mut scrapes) = listen(([127, 0, 0, 1], 0).into()).await.unwrap();
        tokio::spawn(async move {
            while let Some(reply) = scrapes.recv().await {
                let _ = reply.send("x_total 1\n".into());
            }
        });
        let good = get(address, "GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n").await;
        assert!(good.starts_with("HTTP/1.1 200 OK\r\n") && good.ends_with("\r\n\r\nx_total 1\n"), "{good}");
        let head = get(address, "HEAD /metrics HTTP/1.1\r\n\r\n").await;
        assert!(
            head.starts_with("HTTP/1.1 200") && head.ends_with("Length: 10\r\nConnection: close\r\n\r\n")
        );
        assert!(get(address, "GET / HTTP/1.1\r\n\r\n").await.starts_with("HTTP/1.1 404"));
        assert!(get(address, "POST /metrics HTTP/1.1\r\n\r\n").await.starts_with("HTTP/1.1 405"));
        assert!(get(address, &"x".repeat(2 * HEAD)).await.is_empty());
    }
}
