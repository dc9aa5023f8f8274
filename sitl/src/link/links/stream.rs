//! One stream, and what its peer has not read yet: a TCP connection or a serial line.

use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::pin::Pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use serial2_tokio::SerialPort;
use socket2::{SockRef, TcpKeepalive};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;

use super::{Backlog, SendError};

/// After this silence the system asks a TCP peer whether it is still there, and so often until it gives up:
/// a peer that lost its power sends no end of its stream.
const KEEPALIVE: [Duration; 2] = [Duration::from_secs(15), Duration::from_secs(5)];

/// What carries a stream.
pub(super) trait Wire: AsyncRead + AsyncWrite + Unpin + Send + std::fmt::Debug {
    /// Writes what there is room for now.
    fn try_write(&mut self, bytes: &[u8]) -> io::Result<usize>;
}

impl Wire for TcpStream {
    fn try_write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Self::try_write(self, bytes)
    }
}

impl Wire for SerialPort {
    fn try_write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // Nobody needs to be woken: what waits is written when the line is next read.
        match Pin::new(self).poll_write(&mut Context::from_waker(Waker::noop()), bytes) {
            Poll::Ready(written) => written,
            Poll::Pending => Err(ErrorKind::WouldBlock.into()),
        }
    }
}

/// A connection.
#[derive(Debug)]
pub(super) struct LinkStream {
    wire: Box<dyn Wire>,
    unsent: VecDeque<u8>,
}

impl LinkStream {
    pub(super) fn tcp(tcp: TcpStream) -> Self {
        // Frames are small and wait for nobody.
        let _ = tcp.set_nodelay(true);
        let [time, interval] = KEEPALIVE;
        let keepalive = TcpKeepalive::new().with_time(time).with_interval(interval);
        if let Err(error) = SockRef::from(&tcp).set_tcp_keepalive(&keepalive) {
            tracing::debug!("keepalive: {error}");
        }
        Self { wire: Box::new(tcp), unsent: VecDeque::new() }
    }

    pub(super) fn serial(line: SerialPort) -> Self {
        Self { wire: Box::new(line), unsent: VecDeque::new() }
    }

    /// Writes what waits. Ready once nothing waits.
    pub(super) fn poll_write(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        while !self.unsent.is_empty() {
            let (front, _) = self.unsent.as_slices();
            match std::task::ready!(Pin::new(&mut self.wire).poll_write(cx, front)) {
                Ok(0) => return Poll::Ready(Err(ErrorKind::WriteZero.into())),
                Ok(sent) => drop(self.unsent.drain(..sent)),
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
        Poll::Ready(Ok(()))
    }

    /// Writes what waits, as far as there is room, and reads. Bytes read, 0 at the end of the stream.
    pub(super) fn poll_read(&mut self, cx: &mut Context<'_>, buffer: &mut [u8]) -> Poll<io::Result<usize>> {
        if let Poll::Ready(Err(error)) = self.poll_write(cx) {
            return Poll::Ready(Err(error));
        }
        let mut buffer = ReadBuf::new(buffer);
        Pin::new(&mut self.wire).poll_read(cx, &mut buffer).map_ok(|()| buffer.filled().len())
    }

    /// Sends, or keeps, or drops as a whole: a peer never gets a part of `bytes`.
    ///
    /// # Errors
    /// [`SendError::Full`] if the backlog has no room, [`SendError::Io`] if the stream is broken.
    pub(super) fn send(&mut self, bytes: &[u8], backlog: Backlog) -> Result<(), SendError> {
        while !self.unsent.is_empty() {
            let (front, _) = self.unsent.as_slices();
            let Some(sent) = written(self.wire.try_write(front))? else { break };
            self.unsent.drain(..sent);
        }
        let waiting = self.unsent.len();
        if waiting > 0 && waiting + bytes.len() > backlog.limit() {
            return Err(SendError::Full(waiting));
        }
        let mut rest = bytes;
        while self.unsent.is_empty() && !rest.is_empty() {
            let Some(sent) = written(self.wire.try_write(rest))? else { break };
            rest = &rest[sent..];
        }
        self.unsent.extend(rest);
        Ok(())
    }
}

/// How much was written; `None`: there is no room now.
fn written(result: io::Result<usize>) -> io::Result<Option<usize>> {
    match result {
        Ok(0) => Err(ErrorKind::WriteZero.into()),
        Ok(sent) => Ok(Some(sent)),
        Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(None),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Report G9: a TCP peer whose machine is gone was never missed.
    #[tokio::test]
    async fn the_system_asks_a_silent_tcp_peer_whether_it_is_there() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let tcp = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
        let (accepted, _) = listener.accept().await.unwrap();
        // A second handle of the same socket.
        let socket = socket2::Socket::from(accepted.into_std().unwrap());
        let looked_at = socket.try_clone().unwrap();
        let accepted = TcpStream::from_std(socket.into()).unwrap();
        assert!(!looked_at.keepalive().unwrap());
        let _stream = LinkStream::tcp(accepted);
        assert!(looked_at.keepalive().unwrap());
        drop(tcp);
    }
}
