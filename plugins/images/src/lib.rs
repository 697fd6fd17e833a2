//! Output plugin: layer patterns and views as PNG and EXR pictures.
