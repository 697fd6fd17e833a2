//! Job file to scene, light field, layer stack and outputs; cache and resume.
