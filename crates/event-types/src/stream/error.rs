//! Errors of reading and writing events.

use std::error::Error as StdError;
use std::fmt;
use std::io;

/// A result whose error is an [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// The kind of an [`Error`], from which a caller can decide what to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The operating system reported an error: no such file, no permission, a full disk.
    Io(io::ErrorKind),
    /// The input does not follow its format: it is damaged, cut off, or was never valid. All events before that
    /// point were returned.
    Damaged,
    /// A format, or a part of one, that this library does not read or write.
    Unsupported,
    /// The file leaves something open that the caller has to state: a size, a unit, the meaning of the columns.
    Undecided,
    /// The output format cannot hold an event or a sensor.
    CannotHold,
    /// The caller asked for something impossible or destructive; nothing was done.
    Refused,
    /// An error of another kind in a source or a sink.
    Other,
}

/// An error of reading or writing events.
///
/// Its text is one line for people that names the file, the offset and the remedy; `{:#}` appends its causes.
pub struct Error(Box<Inner>);

struct Inner {
    kind: ErrorKind,
    /// The text; `None` if it is that of `cause`.
    what: Option<String>,
    cause: Option<Box<dyn StdError + Send + Sync>>,
}

impl Error {
    /// Creates an error of `kind` with the text `what`.
    pub fn new(kind: ErrorKind, what: impl Into<String>) -> Self {
        Self(Box::new(Inner {
            kind,
            what: Some(what.into()),
            cause: None,
        }))
    }

    /// Wraps an error of a source or a sink that has an error type of its own.
    pub fn other(cause: impl Into<Box<dyn StdError + Send + Sync>>) -> Self {
        Self::caused(ErrorKind::Other, cause.into())
    }

    fn caused(kind: ErrorKind, cause: Box<dyn StdError + Send + Sync>) -> Self {
        // An error that was already of this type stays as it is.
        let cause = match cause.downcast::<Self>() {
            Ok(error) => return *error,
            Err(cause) => cause,
        };
        let kind = match cause.downcast_ref::<io::Error>() {
            Some(error) => ErrorKind::Io(error.kind()),
            None => kind,
        };
        Self(Box::new(Inner {
            kind,
            what: None,
            cause: Some(cause),
        }))
    }

    /// Returns the error's kind, which says what went wrong.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        self.0.kind
    }

    /// Returns the operating system's error that caused this one, if any.
    #[must_use]
    pub fn io(&self) -> Option<&io::Error> {
        let cause = self.0.cause.as_deref()?;
        let inner = || cause.downcast_ref().and_then(Self::io);
        cause.downcast_ref().or_else(inner)
    }

    /// Returns the offset in bytes that the error's text names, if it is about a place in a file: such a text has the form
    /// `NAME: byte N: what`.
    #[must_use]
    pub fn offset(&self) -> Option<u64> {
        let text = format!("{self:#}");
        let rest = text.split(": byte ").nth(1)?;
        let digits = rest.split(|c: char| !c.is_ascii_digit()).next()?;
        digits.parse().ok()
    }

    /// Returns the same error with another kind.
    #[must_use]
    pub fn of_kind(mut self, kind: ErrorKind) -> Self {
        self.0.kind = kind;
        self
    }

    /// Puts a text before the error that says where it occurred; the kind stays.
    #[must_use]
    pub fn context(self, what: impl fmt::Display) -> Self {
        Self(Box::new(Inner {
            kind: self.0.kind,
            what: Some(what.to_string()),
            cause: Some(self.into()),
        }))
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.0.what, &self.0.cause) {
            (Some(what), _) => f.write_str(what)?,
            (None, Some(cause)) => write!(f, "{cause}")?,
            (None, None) => {}
        }
        let mut cause = self.source().filter(|_| f.alternate());
        while let Some(error) = cause {
            write!(f, ": {error}")?;
            cause = error.source();
        }
        Ok(())
    }
}

impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}: {self:#}", self.0.kind)
    }
}

impl StdError for Error {
    fn source(&self) -> Option<&(dyn StdError + 'static)> {
        let cause = self.0.cause.as_deref()?;
        match &self.0.what {
            Some(_) => Some(cause),
            None => cause.source(),
        }
    }
}

impl From<io::Error> for Error {
    fn from(error: io::Error) -> Self {
        Self::caused(ErrorKind::Other, error.into())
    }
}

/// Converts a failure into an [`Error`] that says where it occurred.
pub trait Context<T> {
    /// Puts `what` before the error. An I/O error and an [`Error`] keep their kind; any other error, and a missing
    /// value, is [`ErrorKind::Damaged`].
    ///
    /// # Errors
    /// `self` is an error, or `None`.
    fn context(self, what: impl fmt::Display) -> Result<T>;

    /// Does the same as [`Context::context`], but makes the text only if there is an error.
    ///
    /// # Errors
    /// Those of [`Context::context`].
    fn with_context<D: fmt::Display>(self, what: impl FnOnce() -> D) -> Result<T>;
}

impl<T, E: StdError + Send + Sync + 'static> Context<T> for Result<T, E> {
    fn context(self, what: impl fmt::Display) -> Result<T> {
        self.with_context(|| what)
    }

    fn with_context<D: fmt::Display>(self, what: impl FnOnce() -> D) -> Result<T> {
        self.map_err(|error| Error::caused(ErrorKind::Damaged, error.into()).context(what()))
    }
}

impl<T> Context<T> for Option<T> {
    fn context(self, what: impl fmt::Display) -> Result<T> {
        self.with_context(|| what)
    }

    fn with_context<D: fmt::Display>(self, what: impl FnOnce() -> D) -> Result<T> {
        self.ok_or_else(|| Error::new(ErrorKind::Damaged, what().to_string()))
    }
}

/// Makes an [`Error`](crate::stream::Error) of a kind, with a text in the syntax of `format!`.
///
/// ```
/// use event_types::error;
/// use event_types::stream::ErrorKind;
///
/// let byte = 7;
/// let error = error!(Damaged, "byte {byte}: no event");
/// assert_eq!(error.to_string(), "byte 7: no event");
/// assert_eq!(error.kind(), ErrorKind::Damaged);
/// ```
#[macro_export]
macro_rules! error {
    ($kind:ident, $($text:tt)+) => {
        $crate::stream::Error::new($crate::stream::ErrorKind::$kind, ::std::format!($($text)+))
    };
}

/// Returns from the function with the [`error!`](crate::error) of a kind and a text.
#[macro_export]
macro_rules! bail {
    ($kind:ident, $($text:tt)+) => {
        return ::core::result::Result::Err(::core::convert::From::from($crate::error!($kind, $($text)+)))
    };
}

/// Returns from the function with the [`error!`](crate::error) of a kind and a text unless a condition holds.
#[macro_export]
macro_rules! ensure {
    ($condition:expr, $kind:ident, $($text:tt)+) => {
        if !$condition {
            $crate::bail!($kind, $($text)+);
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fails() -> Result<()> {
        let absent = io::Error::new(io::ErrorKind::NotFound, "no such file");
        Err(absent).context("a.raw: cannot be opened")
    }

    #[test]
    fn causes_stand_behind_what_was_met() {
        let error = fails().with_context(|| "converting").unwrap_err();
        assert_eq!(error.to_string(), "converting");
        let chain = "converting: a.raw: cannot be opened: no such file";
        assert_eq!(format!("{error:#}"), chain);
        assert_eq!(error.kind(), ErrorKind::Io(io::ErrorKind::NotFound));
        assert_eq!(error.io().unwrap().to_string(), "no such file");
    }

    #[test]
    fn texts_about_a_place_have_its_offset() {
        let error = crate::error!(Damaged, "a.raw: byte 1234: no event");
        assert_eq!(error.offset(), Some(1234));
        assert_eq!(
            error.context("b.raw: cannot be written").offset(),
            Some(1234)
        );
        for text in ["a.raw: line 3: no event", "a: byte x: ?", ""] {
            assert_eq!(
                Error::new(ErrorKind::Damaged, text).offset(),
                None,
                "{text}"
            );
        }
    }

    #[test]
    fn errors_of_others_keep_their_text_and_their_causes() {
        let inner = fails().unwrap_err();
        let error = Error::other(inner);
        assert_eq!(error.kind(), ErrorKind::Io(io::ErrorKind::NotFound));
        let error = Error::other("a word").context("b");
        assert_eq!(format!("{error:#}"), "b: a word");
        assert_eq!(error.kind(), ErrorKind::Other);
        let error: Error = io::Error::other("disk").into();
        assert_eq!(format!("{error:#}"), "disk");
        let none: Option<u8> = None;
        assert_eq!(
            none.context("byte 3").unwrap_err().kind(),
            ErrorKind::Damaged
        );
    }
}
