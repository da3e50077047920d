//! Errors of the libraries as exceptions of Python.

use std::io;

use event_types::stream::{Error, ErrorKind};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;

/// Returns the exception for an error; `file` is the file that was asked for, if there is one.
pub fn exception(py: Python<'_>, error: &Error, file: Option<&str>) -> PyErr {
    let (kind, errno) = match error.kind() {
        ErrorKind::Io(io::ErrorKind::NotFound) => ("missing", errno(error)),
        ErrorKind::Io(_) => ("io", errno(error)),
        ErrorKind::Damaged => ("damaged", None),
        ErrorKind::Unsupported => ("unsupported", None),
        ErrorKind::Undecided => ("undecided", None),
        ErrorKind::CannotHold => ("cannot_hold", None),
        ErrorKind::Refused => ("refused", None),
        _ => ("other", None),
    };
    let text = keywords(&format!("{error:#}"));
    let made = (|| {
        let make = py.import("eecvs._errors")?.getattr("_make")?;
        make.call1((kind, text, file, error.offset(), errno))
    })();
    made.map_or_else(|failed| failed, PyErr::from_value)
}

fn errno(error: &Error) -> Option<i32> {
    error.io()?.raw_os_error()
}

/// Writes the command's flags in a text as keywords: `--time-unit` becomes `time_unit=`.
pub fn keywords(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text
        .strip_prefix('-')
        .filter(|rest| rest.starts_with("m "))
        .unwrap_or(text);
    while let Some(at) = rest.find("--") {
        let (before, flag) = rest.split_at(at);
        out.push_str(before);
        let flag = flag.trim_start_matches('-');
        let length = flag
            .find(|c: char| !c.is_ascii_lowercase() && c != '-')
            .unwrap_or(flag.len());
        let (name, after) = flag.split_at(length);
        let is_flag =
            !name.is_empty() && before.chars().last().is_none_or(|c| !c.is_alphanumeric());
        if is_flag {
            out.push_str(&name.replace('-', "_"));
            out.push('=');
            // `--coder dense` is `coder=dense`.
            rest = after
                .strip_prefix(' ')
                .filter(|next| is_value(next))
                .unwrap_or(after);
        } else {
            out.push_str("--");
            out.push_str(name);
            rest = after;
        }
    }
    out.push_str(rest);
    out
}

/// Returns whether a text goes on with a value that the libraries' texts give to flags.
fn is_value(text: &str) -> bool {
    let word: String = text
        .chars()
        .take_while(char::is_ascii_alphanumeric)
        .collect();
    const VALUES: [&str; 9] = [
        "best",
        "dense",
        "fast",
        "hybrid",
        "plain",
        "quick",
        "transform",
        "auto",
        "off",
    ];
    // `--width W` is `width=W`.
    let is_place = !word.is_empty() && word.chars().all(|c| c.is_ascii_uppercase());
    is_place || VALUES.contains(&word.as_str()) || word.starts_with(|c: char| c.is_ascii_digit())
}

/// Issues the warning that something was lost.
pub fn warn_of_loss(py: Python<'_>, text: &str) -> PyResult<()> {
    static WARNING: PyOnceLock<Py<PyType>> = PyOnceLock::new();
    let category = WARNING.get_or_try_init(py, || {
        let warning = py.import("eecvs._errors")?.getattr("LossWarning")?;
        Ok::<_, PyErr>(warning.cast_into::<PyType>()?.unbind())
    });
    let text = std::ffi::CString::new(keywords(text).replace('\0', " ")).unwrap_or_default();
    match category {
        Ok(category) => PyErr::warn(py, category.bind(py), &text, 2),
        Err(_) => PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 2),
    }
}
