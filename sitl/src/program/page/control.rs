//! What a page may ask of a vehicle, and the way from the server's thread to the shell that has the link.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use tokio::sync::{mpsc, oneshot};
use tokio::time::timeout;

/// Requests that wait at most.
const WAITING: usize = 4;

/// How long a shell may take for an answer.
const PATIENCE: Duration = Duration::from_secs(15);

/// Random bytes of a token.
const TOKEN: usize = 16;

/// What is asked of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VehicleAction {
    /// Stay where it is.
    Hold,
    /// Fly home.
    Return,
    /// Land here.
    Land,
    /// Follow the station again.
    GiveBack,
}

impl VehicleAction {
    /// In words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Hold => "hold",
            Self::Return => "return",
            Self::Land => "land",
            Self::GiveBack => "give back",
        }
    }
}

/// A request under way.
#[derive(Debug)]
pub struct VehicleRequest {
    /// The vehicle's number on the page.
    pub vehicle: u32,
    /// What it shall do.
    pub action: VehicleAction,
    /// The vehicle's answer, in words.
    pub answer: oneshot::Sender<Result<String, String>>,
}

/// The shell's end, for the one flight that takes it.
#[derive(Debug, Clone)]
pub struct RequestQueue(Arc<Mutex<Option<mpsc::Receiver<VehicleRequest>>>>);

impl RequestQueue {
    /// The requests; `None` if somebody has taken them.
    #[must_use]
    pub fn take(&self) -> Option<mpsc::Receiver<VehicleRequest>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

/// The server's end.
#[derive(Debug, Clone)]
pub struct PageControl {
    token: String,
    requests: mpsc::Sender<VehicleRequest>,
}

impl PageControl {
    /// A new token, and the shell's end.
    ///
    /// # Errors
    /// The system has no random bytes.
    pub fn open() -> Result<(Self, RequestQueue)> {
        let mut bytes = [0; TOKEN];
        getrandom::fill(&mut bytes).context("drawing a token")?;
        let token = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        let (requests, shell) = mpsc::channel(WAITING);
        Ok((Self { token, requests }, RequestQueue(Arc::new(Mutex::new(Some(shell))))))
    }

    /// What a request must bring.
    #[must_use]
    pub fn token(&self) -> &str {
        &self.token
    }

    /// Whether this is the token; takes as long whichever byte differs.
    #[must_use]
    pub fn is_token(&self, token: &str) -> bool {
        let (ours, theirs) = (self.token.as_bytes(), token.as_bytes());
        ours.len() == theirs.len() && ours.iter().zip(theirs).fold(0, |all, (a, b)| all | (a ^ b)) == 0
    }

    /// Asks the shell, and waits for the vehicle's answer.
    ///
    /// # Errors
    /// Why not, in words.
    pub async fn ask(&self, vehicle: u32, action: VehicleAction) -> Result<String, String> {
        let (answer, answered) = oneshot::channel();
        let request = VehicleRequest { vehicle, action, answer };
        if self.requests.try_send(request).is_err() {
            return Err("nobody flies now, or four requests wait already".into());
        }
        match timeout(PATIENCE, answered).await {
            Ok(Ok(answer)) => answer,
            Ok(Err(_)) => Err("the flight has ended".into()),
            Err(_) => Err("no answer yet".into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_request_reaches_the_shell_and_its_answer_comes_back() {
        let (control, queue) = PageControl::open().unwrap();
        let mut shell = queue.take().unwrap();
        assert!(queue.take().is_none());
        let asked = tokio::spawn({
            let control = control.clone();
            async move { control.ask(1, VehicleAction::GiveBack).await }
        });
        let request = shell.recv().await.unwrap();
        assert_eq!((request.vehicle, request.action), (1, VehicleAction::GiveBack));
        request.answer.send(Ok("accepted".into())).unwrap();
        assert_eq!(asked.await.unwrap(), Ok("accepted".into()));
        drop(shell);
        assert!(control.ask(1, VehicleAction::Land).await.is_err());
    }

    #[test]
    fn tokens_differ_and_only_their_own_fits() {
        let (a, b) = (PageControl::open().unwrap().0, PageControl::open().unwrap().0);
        assert_ne!(a.token(), b.token());
        assert!(a.is_token(a.token()) && !a.is_token(b.token()) && !a.is_token(""));
    }
}
