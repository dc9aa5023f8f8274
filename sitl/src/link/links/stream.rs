//! One TCP connection, and what its peer has not read yet.

use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;

use super::{Backlog, SendError};

/// A connection.
#[derive(Debug)]
pub(super) struct LinkStream {
    tcp: TcpStream,
    unsent: VecDeque<u8>,
}

impl LinkStream {
    pub(super) fn new(tcp: TcpStream) -> Self {
        // Frames are small and wait for nobody.
        let _ = tcp.set_nodelay(true);
        Self { tcp, unsent: VecDeque::new() }
    }

    /// Writes what waits. Ready once nothing waits.
    pub(super) fn poll_write(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        while !self.unsent.is_empty() {
            let (front, _) = self.unsent.as_slices();
            match std::task::ready!(Pin::new(&mut self.tcp).poll_write(cx, front)) {
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
        Pin::new(&mut self.tcp).poll_read(cx, &mut buffer).map_ok(|()| buffer.filled().len())
    }

    /// Sends, or keeps, or drops as a whole: a peer never gets a part of `bytes`.
    ///
    /// # Errors
    /// [`SendError::Full`] if the backlog has no room, [`SendError::Io`] if the stream is broken.
    pub(super) fn send(&mut self, bytes: &[u8], backlog: Backlog) -> Result<(), SendError> {
        while !self.unsent.is_empty() {
            let (front, _) = self.unsent.as_slices();
            let Some(sent) = written(self.tcp.try_write(front))? else { break };
            self.unsent.drain(..sent);
        }
        let waiting = self.unsent.len();
        if waiting > 0 && waiting + bytes.len() > backlog.limit() {
            return Err(SendError::Full(waiting));
        }
        let mut rest = bytes;
        while self.unsent.is_empty() && !rest.is_empty() {
            let Some(sent) = written(self.tcp.try_write(rest))? else { break };
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
