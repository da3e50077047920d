//! Environment variables that a library reads once, at its first use.

/// Gives Zenoh's runtime more threads for receiving (default 2) and connecting (default 1), unless `ZENOH_RUNTIME` is
/// set. It must be called before anything else is done.
///
/// A link whose other end hangs is given up after some seconds. Zenoh closes the link's socket in one of these
/// threads and lets unsent data linger, so with a full socket that thread waits for ten more seconds. With no
/// thread left, nothing would be received from anyone, and publishers would drop messages. The number of links that
/// may be closed at the same time is one less than the number of threads of a kind.
pub fn have_zenoh_threads() {
    set_from_the_start(
        "ZENOH_RUNTIME",
        "(rx: (worker_threads: 8), net: (worker_threads: 8))",
    );
}

/// Ensures that a variable is set from the start of this program: if it is not, the program replaces itself by a new
/// instance with the variable set, under the same process id. It must be called before anything else is done. Nothing
/// happens on systems without `exec`.
///
/// Setting the variable in the running program would be undefined behaviour as soon as another thread reads any
/// variable.
fn set_from_the_start(name: &str, value: &str) {
    #[cfg(unix)]
    if std::env::var_os(name).is_none()
        && let Ok(program) = std::env::current_exe()
    {
        use std::os::unix::process::CommandExt as _;
        let mut line = std::env::args_os();
        let mut again = std::process::Command::new(program);
        if let Some(own_name) = line.next() {
            again.arg0(own_name);
        }
        // `exec` returns only if it fails; the program then continues without the variable.
        let _failed = again.args(line).env(name, value).exec();
    }
    #[cfg(not(unix))]
    let _ = (name, value);
}
