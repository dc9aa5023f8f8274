//! Threads whose work may be late.

/// How much nicer such a thread is: it gets a tenth of a core that a flight wants, too.
#[cfg(target_os = "linux")]
const NICER: i32 = 10;

/// From now on the calling thread gives way to those that have the program's own priority. Does nothing where the
/// system knows priorities of whole programs alone.
pub fn give_way() {
    #[cfg(target_os = "linux")]
    {
        // A thread that may not is as it was.
        let _ = rustix::process::nice(NICER);
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use rustix::process::getpriority_process;

    use super::*;

    #[test]
    fn a_thread_gives_way_alone() {
        let own = || getpriority_process(None).unwrap();
        let before = own();
        let nicer = std::thread::spawn(move || {
            give_way();
            own()
        });
        assert_eq!((nicer.join().unwrap(), own()), ((before + NICER).min(19), before));
    }
}
