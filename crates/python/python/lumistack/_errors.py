"""Exceptions of the package. They have the messages of the command line. If a message names a flag,
the flag is replaced by the argument of the Python function."""


class Error(Exception):
    """The base of all exceptions of Lumistack."""


class FileError(Error, OSError):
    """A file or folder cannot be read or written."""


class MissingFileError(FileError, FileNotFoundError):
    """A file or folder does not exist."""


class SettingError(Error, ValueError):
    """A setting, a job or a display is invalid: an unknown name, a value out of range."""


class DataError(Error, ValueError):
    """A light field or patterns cannot be used: damaged, incomplete, or of a shape that does not fit
    the display."""


class SceneError(Error, ValueError):
    """A scene cannot be used."""


class RenderError(Error):
    """The path tracer cannot render the scene."""


class FactorizeError(Error, ValueError):
    """The factorizer cannot use its input."""


class PluginError(Error):
    """A plugin does not exist, refuses its parameters or data, or failed."""


class InternalError(Error):
    """An error in Lumistack itself. Please report its message."""


class LumistackWarning(UserWarning):
    """A warning for the user; the work continues."""


for _class in list(globals().values()):
    if isinstance(_class, type):
        _class.__module__ = "lumistack"
