//! Variables of the environment that a library reads once, at its first use.

/// Gives the runtime of Zenoh more threads for receiving and connecting than its two and one, unless its variable is set.
/// It is called before anything else is done.
///
/// A link whose other end hangs is given up after some seconds. Zenoh closes its socket in one of these threads, and has
/// what was not sent linger: with a full socket that thread waits for ten seconds more. With no thread left, nothing
/// would be received from anyone, and publishers would drop messages. As many links may be closed at a time as there
/// are threads of the kind, less one.
pub fn have_zenoh_threads() {
    set_from_the_start(
        "ZENOH_RUNTIME",
        "(rx: (worker_threads: 8), net: (worker_threads: 8))",
    );
}

/// Sees to it that a variable is set from this program's start on: where it is not, the program takes its own place with
/// the variable set, under the same number of process. It is called before anything else is done. Where the system does
/// not do that, nothing happens.
///
/// Setting it in a running program would be undefined as soon as another thread reads any variable.
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
        // It returns where it has failed, and the program goes on without.
        let _failed = again.args(line).env(name, value).exec();
    }
    #[cfg(not(unix))]
    let _ = (name, value);
}
