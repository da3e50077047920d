//! A variable of the environment that a library reads once, at its first use.

/// Sees to it that a variable is set from this program's start on: where it is not, the program takes its own place with
/// the variable set, under the same number of process. It is called before anything else is done. Where the system does
/// not do that, nothing happens.
///
/// Setting it in a running program would be undefined as soon as another thread reads any variable.
pub fn set_from_the_start(name: &str, value: &str) {
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
