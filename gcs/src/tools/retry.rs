//! What is asked again until it is answered. No socket, no clock, no message.
//!
//! The standard leaves the number of attempts to the station. At a loss of 20 % each way a question
//! and its answer both come through in 64 % of all attempts, so of 12 in a row one in 200,000 fails.

use std::time::Duration;

/// The standard's wait before something is sent again.
const RETRY: Duration = Duration::from_millis(700);
/// How often anything is sent in all, without progress.
const ATTEMPTS: u32 = 12;

/// When to send again what is not answered, and when to give up.
#[derive(Debug, Clone, Copy, Default)]
pub struct Retry {
    due: Duration,
    attempts: u32,
}

/// It was sent in vain too often.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GaveUp;

impl Retry {
    /// Whether it is to be sent now.
    ///
    /// # Errors
    /// It was sent as often as allowed, and no answer came.
    pub fn fires(&mut self, now: Duration) -> Result<bool, GaveUp> {
        if now < self.due {
            return Ok(false);
        }
        if self.attempts == ATTEMPTS {
            return Err(GaveUp);
        }
        self.attempts += 1;
        self.due = now + RETRY;
        Ok(true)
    }

    /// The other side has gone on: the next question is due then, and has all its attempts.
    pub fn go_on(&mut self, due: Duration) {
        *self = Self { due, attempts: 0 };
    }

    /// Sends at `due`, without another attempt.
    pub fn not_before(&mut self, due: Duration) {
        self.due = due;
    }

    /// Whether it has been sent.
    #[must_use]
    pub fn asked(&self) -> bool {
        self.attempts > 0
    }

    /// When [`Retry::fires`] has something to do next.
    #[must_use]
    pub fn due(&self) -> Duration {
        self.due
    }
}

/// A question until it has its answer.
#[derive(Debug)]
pub struct Question<T> {
    /// When to ask.
    pub retry: Retry,
    answer: Option<Result<T, String>>,
}

impl<T> Default for Question<T> {
    fn default() -> Self {
        Self { retry: Retry::default(), answer: None }
    }
}

impl<T> Question<T> {
    /// The answer has come: what was asked for, or why not, in words.
    pub fn answered(&mut self, answer: Result<T, String>) {
        self.answer = Some(answer);
    }

    /// Whether to ask now. `silence` are the words for no answer at all.
    pub fn fires(&mut self, now: Duration, silence: impl FnOnce() -> String) -> bool {
        if self.answer.is_some() {
            return false;
        }
        self.retry.fires(now).unwrap_or_else(|GaveUp| {
            self.answer = Some(Err(silence()));
            false
        })
    }

    /// The answer, once.
    pub fn take(&mut self) -> Option<Result<T, String>> {
        self.answer.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_asked_in_vain_so_often_and_progress_begins_anew() {
        let mut question = Question::<()>::default();
        let mut now = Duration::ZERO;
        let mut asked = 0;
        while question.take().is_none() {
            asked += u32::from(question.fires(now, || "nobody".into()));
            if asked == 5 && question.retry.attempts == 5 {
                question.retry.go_on(now);
            }
            now = question.retry.due().max(now + Duration::from_millis(1));
        }
        assert_eq!(asked, 5 + ATTEMPTS);
    }

    #[test]
    fn an_answer_ends_it() {
        let mut question = Question::default();
        assert!(!question.retry.asked());
        assert!(question.fires(Duration::ZERO, String::new));
        assert!(!question.fires(RETRY / 2, String::new), "it waits");
        question.answered(Ok(7));
        assert!(!question.fires(RETRY, String::new) && question.retry.asked());
        assert_eq!(question.take(), Some(Ok(7)));
    }
}
