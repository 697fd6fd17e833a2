
use lumistack_field_io::picture::Picture;
use lumistack_core::seed::Stream;
use exr::prelude::*;
#[test]
fn fuzz() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = vec![];
    let mut st = Stream::new(3);
    let noise: Vec<f32> = (0..70*50).map(|i| st.next_f32() + (i%70) as f32 * 0.1).collect();
    for (k, c) in [Compression::Uncompressed, Compression::RLE, Compression::ZIP1, Compression::ZIP16, Compression::PIZ, Compression::PXR24, Compression::B44, Compression::B44A, Compression::DWAA(None)].into_iter().enumerate() {
        for tiles in [false, true] {
            let path = folder.path().join(format!("{k}{tiles}.exr"));
            let blocks = if tiles { Blocks::Tiles(Vec2(32,32)) } else { Blocks::ScanLines };
            let ch = ["R","G","B"].map(|n| AnyChannel::new(n, FlatSamples::F16(noise.iter().map(|v| f16::from_f32(*v)).collect())));
            let layer = Layer::new((70,50), LayerAttributes::default(), Encoding{compression:c, blocks, line_order: LineOrder::Increasing}, AnyChannels::sort(ch.into_iter().collect()));
            if let Err(e) = Image::from_layer(layer).write().to_file(&path) { println!("{k} {tiles} {e}"); continue; }
            if let Err(e) = Picture::read(&path) { println!("read {k} {tiles} {e}"); }
            files.push(path);
        }
    }
    for n in ["a.png","a.jpg","a.webp","a.hdr"] {
        let path = folder.path().join(n);
        let im = image::RgbImage::from_fn(70,50,|x,y| image::Rgb([(x*y) as u8,(x^y) as u8,(x*7+y*3) as u8]));
        if n.ends_with("hdr") { image::DynamicImage::ImageRgb8(im).into_rgb32f().save(&path).unwrap() } else { im.save(&path).unwrap(); }
        files.push(path);
    }
    let mut panics = 0; let mut worst = (0u128, String::new());
    for file in files {
        let whole = std::fs::read(&file).unwrap();
        for round in 0..1500u64 {
            let mut d = whole.clone();
            let n = 1 + st.next_u64() % 3;
            for _ in 0..n {
                let range = if round % 2 == 0 { d.len().min(450) } else { d.len() };
                let at = (st.next_u64() % range as u64) as usize; d[at] = if round%3==0 {0xff} else {st.next_u64() as u8}; }
            std::fs::write(&file, &d).unwrap();
            let t = std::time::Instant::now();
            let r = std::panic::catch_unwind(|| { Picture::read(&file).ok(); });
            let e = t.elapsed().as_millis();
            if e > worst.0 { worst = (e, format!("{} {round}", file.display())); }
            if r.is_err() { panics += 1; std::fs::write(format!("/tmp/tBpanic_{panics}_{}", file.file_name().unwrap().to_str().unwrap()), &d).unwrap(); println!("PANIC {} {round}", file.display()); }
        }
    }
    println!("panics {panics} worst {worst:?}");
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    println!("{}", status.lines().filter(|l| l.starts_with("VmHWM")).collect::<String>());
}
