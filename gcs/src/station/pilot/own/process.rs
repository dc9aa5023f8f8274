//! A program of somebody else behind pipes: one line in, one line out, and never a wait without an end.
//!
//! Two threads stand between the pipes and the flight, so neither a program that says nothing nor one that reads
//! nothing can hold it up.

#![expect(
    clippy::disallowed_methods,
    reason = "a shell: a program of somebody else may not hold up a flight"
)]

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

/// The longest line that is read: more is no answer.
const LONGEST_LINE: u64 = 1 << 20;
/// How long a program may take to end once its input is closed.
const FAREWELL: Duration = Duration::from_millis(500);

/// Why there is no line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Silence {
    /// Not within the time.
    #[error("no answer within {0:?}")]
    TimedOut(Duration),
    /// It has ended, or closed its output.
    #[error("the program has ended ({0})")]
    Ended(String),
}

/// A running program.
#[derive(Debug)]
pub struct Process {
    child: Child,
    /// `None` once it is to end.
    input: Option<Sender<String>>,
    output: Receiver<String>,
}

impl Process {
    /// Starts the program with these words; what it says on stderr goes where ours does.
    ///
    /// # Errors
    /// There is no such program.
    pub fn start(words: &[String]) -> std::io::Result<Self> {
        let (program, arguments) = words.split_first().ok_or(std::io::ErrorKind::InvalidInput)?;
        let mut child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()?;
        let (input, lines) = channel();
        let (told, output) = channel();
        if let (Some(stdin), Some(stdout)) = (child.stdin.take(), child.stdout.take()) {
            std::thread::spawn(move || write(stdin, &lines));
            std::thread::spawn(move || read(stdout, &told));
        }
        Ok(Self { child, input: Some(input), output })
    }

    /// Sends a line. What cannot be sent shows as an answer that does not come.
    pub fn send(&self, line: String) {
        if let Some(input) = &self.input {
            let _ = input.send(line);
        }
    }

    /// The next line, for which `take` gives a value; lines for which it gives `None` are passed over.
    ///
    /// # Errors
    /// There is none in time.
    pub fn receive<T>(
        &mut self,
        patience: Duration,
        mut take: impl FnMut(&str) -> Option<T>,
    ) -> Result<T, Silence> {
        let until = Instant::now() + patience;
        loop {
            match self.output.recv_timeout(until.saturating_duration_since(Instant::now())) {
                Ok(line) => {
                    if let Some(taken) = take(&line) {
                        return Ok(taken);
                    }
                }
                Err(RecvTimeoutError::Timeout) => return Err(Silence::TimedOut(patience)),
                Err(RecvTimeoutError::Disconnected) => return Err(Silence::Ended(self.status())),
            }
        }
    }

    /// With what it has ended, for a person.
    fn status(&mut self) -> String {
        match self.ended_within(FAREWELL) {
            Some(status) => status.to_string(),
            None => "it has closed its output".into(),
        }
    }

    fn ended_within(&mut self, patience: Duration) -> Option<std::process::ExitStatus> {
        let until = Instant::now() + patience;
        loop {
            if let Ok(Some(status)) = self.child.try_wait() {
                return Some(status);
            }
            if Instant::now() >= until {
                return None;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // The end of its input is its signal to end.
        self.input = None;
        if self.ended_within(FAREWELL).is_none() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

fn write(mut to: ChildStdin, lines: &Receiver<String>) {
    for mut line in lines {
        line.push('\n');
        if to.write_all(line.as_bytes()).and_then(|()| to.flush()).is_err() {
            return;
        }
    }
}

fn read(from: ChildStdout, told: &Sender<String>) {
    let mut from = BufReader::new(from);
    let mut bytes = Vec::new();
    loop {
        bytes.clear();
        match from.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut bytes) {
            Ok(0) | Err(_) => return,
            Ok(_) => {
                let line = String::from_utf8_lossy(&bytes);
                if told.send(line.trim_end().to_owned()).is_err() {
                    return;
                }
            }
        }
    }
}
