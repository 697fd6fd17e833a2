//! Access to the decoders of packed content, the readers of light fields and the writer of zip
//! files. In a page, a small WebAssembly module has the decoders of common pictures, and another
//! module has all other functions. Outside of the browser this crate calls the crate
//! `lumistack-web-decoders` directly.

#[cfg(target_arch = "wasm32")]
pub(crate) use page::{field, pack, unpack};

#[cfg(not(target_arch = "wasm32"))]
pub(crate) use beside::{field, pack, unpack};

/// Geometry for a light field whose files do not state it, and the largest width of its views.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wanted {
    /// Width of the light field's rectangle on the display plane, mm.
    pub(crate) width_mm: f64,
    /// [horizontal, vertical] full angle that the views cover, degrees.
    pub(crate) fov_deg: [f64; 2],
    /// Largest number of pixel columns of a view; views with more columns are reduced to this
    /// number.
    pub(crate) cols: usize,
}

#[cfg(not(target_arch = "wasm32"))]
mod beside {
    use lumistack_core::Task;
    use lumistack_display::LightField;
    use lumistack_web_decoders as decoders;
    pub(crate) use lumistack_web_decoders::unpack;

    use super::Wanted;
    use crate::error::Error;

    /// Packs `display.toml` and files, in this order, as a zip. `display` is the display as JSON.
    pub(crate) fn pack(display: &str, files: &[(String, Vec<u8>)]) -> Result<Vec<u8>, String> {
        decoders::pack(display, files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())))
    }

    /// Reads a light field of any kind that the command reads.
    pub(crate) fn field(path: &str, wanted: &Wanted, task: Task<'_>) -> Result<LightField, Error> {
        let &Wanted { width_mm, fov_deg, cols } = wanted;
        let wanted = decoders::Wanted { width_mm, fov_deg, cols };
        decoders::field(path, &wanted, task).map_err(|error| Error(error.to_string()))
    }
}

#[cfg(target_arch = "wasm32")]
mod page {
    use js_sys::{Error, Uint8Array};
    use lumistack_core::{Task, Tensor};
    use lumistack_display::{FieldGeometry, LightField, Projection, ViewGrid};
    use lumistack_gltf::unpack::{Packed, Unpacked, Unsound, answered};
    use wasm_bindgen::prelude::*;

    use super::Wanted;
    use crate::error::Error as Sentence;

    // `worker.ts` defines these functions. The first call that needs a module of decoders loads it.
    #[wasm_bindgen]
    extern "C" {
        #[wasm_bindgen(catch, js_namespace = lumistack_decoders)]
        fn answer(request: &[u8], is_common: bool) -> Result<Option<Vec<u8>>, JsValue>;
        #[wasm_bindgen(catch, js_namespace = lumistack_decoders, js_name = pack)]
        fn pack_files(display: &str, names: Vec<String>, contents: Vec<Uint8Array>) -> Result<Vec<u8>, JsValue>;
        #[wasm_bindgen(catch, js_namespace = lumistack_decoders, js_name = field)]
        fn read_field(path: &str, width_mm: f64, fov_x_deg: f64, fov_y_deg: f64, cols: usize)
        -> Result<Field, JsValue>;

        type Field;
        #[wasm_bindgen(method, getter)]
        fn rows(this: &Field) -> usize;
        #[wasm_bindgen(method, getter)]
        fn cols(this: &Field) -> usize;
        #[wasm_bindgen(method, getter)]
        fn pitch_mm(this: &Field) -> f64;
        #[wasm_bindgen(method, getter)]
        fn distance_mm(this: &Field) -> Option<f64>;
        #[wasm_bindgen(method, getter)]
        fn slope_x(this: &Field) -> Vec<f64>;
        #[wasm_bindgen(method, getter)]
        fn slope_y(this: &Field) -> Vec<f64>;
        #[wasm_bindgen(method, getter)]
        fn radiance(this: &Field) -> Vec<f32>;
        #[wasm_bindgen(method, getter)]
        fn warnings(this: &Field) -> Vec<String>;
        #[wasm_bindgen(method)]
        fn free(this: &Field);
    }

    fn message(error: &JsValue) -> String {
        error.dyn_ref::<Error>().map_or_else(|| format!("{error:?}"), |error| error.message().into())
    }

    pub(crate) fn unpack(packed: &Packed<'_>) -> Result<Unpacked, Unsound> {
        let unreachable = |error: JsValue| {
            Unsound {
            place: String::new(),
            expected: "the decoders of this page, lumistack_web_pictures_bg.wasm and lumistack_web_decoders_bg.wasm, on the page's server"
                .into(),
            found: message(&error),
        }
        };
        // if there is no answer, the module of decoders stopped on damaged content
        let found = answer(&packed.to_bytes(), packed.is_common()).map_err(unreachable)?;
        found.as_deref().and_then(answered).unwrap_or_else(|| Err(packed.stopped()))
    }

    pub(crate) fn pack(display: &str, files: &[(String, Vec<u8>)]) -> Result<Vec<u8>, String> {
        let names = files.iter().map(|(name, _)| name.clone()).collect();
        let contents = files.iter().map(|(_, bytes)| Uint8Array::from(bytes.as_slice())).collect();
        pack_files(display, names, contents).map_err(|error| message(&error))
    }

    pub(crate) fn field(path: &str, wanted: &Wanted, task: Task<'_>) -> Result<LightField, Sentence> {
        let Wanted { width_mm, fov_deg: [fov_x_deg, fov_y_deg], cols } = *wanted;
        let read = read_field(path, width_mm, fov_x_deg, fov_y_deg, cols);
        let read = read.map_err(|error| Sentence(message(&error)))?;
        let warnings = read.warnings();
        warnings.as_chunks::<2>().0.iter().for_each(|[place, message]| task.warn(place.clone(), message.clone()));
        let projection = match read.distance_mm() {
            None => Projection::Oblique,
            Some(distance_mm) => Projection::Perspective { distance_mm },
        };
        let grid = ViewGrid { projection, slope_x: read.slope_x(), slope_y: read.slope_y() };
        let geometry = FieldGeometry { rows: read.rows(), cols: read.cols(), pitch_mm: read.pitch_mm(), grid };
        let radiance = Tensor::from_vec(LightField::AXES, LightField::shape_of(&geometry), read.radiance());
        read.free();
        let failed = |error: &dyn std::fmt::Display| Sentence(format!("{path}: {error}"));
        let radiance = radiance.map_err(|error| failed(&error))?;
        LightField::new(geometry, radiance).map_err(|error| failed(&error))
    }
}
