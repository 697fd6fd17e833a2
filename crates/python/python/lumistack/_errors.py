"""What the package raises; each message is the one that the command line prints."""


class Error(Exception):
    """Something that Lumistack cannot do; the base of all its exceptions."""


class FileError(Error, OSError):
    """A file or folder cannot be read or written."""


class MissingFileError(FileError, FileNotFoundError):
    """A file or folder is not there."""


class SettingError(Error, ValueError):
    """A setting, a job or a display makes no sense: unknown names, values out of range."""


class DataError(Error, ValueError):
    """A light field or patterns that cannot be used: damaged, incomplete, or of another shape than the display's."""


class SceneError(Error, ValueError):
    """A scene that cannot be used."""


class RenderError(Error):
    """The path tracer cannot render the scene."""


class FactorizeError(Error, ValueError):
    """The factorizer cannot use what it was given."""


class PluginError(Error):
    """A plugin is not there, does not take its parameters or data, or failed."""


class InternalError(Error):
    """A mistake in Lumistack. The message says where; please report it."""


class LumistackWarning(UserWarning):
    """Something that the user should know and that does not stop the work."""


for _class in list(globals().values()):
    if isinstance(_class, type):
        _class.__module__ = "lumistack"
