// Saves pictures and videos as downloads.

/** Formats of videos, best first; the first one that MediaRecorder supports is used. */
const FORMATS = ["video/mp4;codecs=avc1.640028", "video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm"];
const BITS_PER_S = 12e6;
/** Smallest width of a video, pixels. Smaller pictures are enlarged by a whole factor. */
const VIDEO_PX = 960;

export function download(blob: Blob, name: string): void {
  const url = URL.createObjectURL(blob);
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}

export function toPng(canvas: HTMLCanvasElement): Promise<Blob> {
  return new Promise((resolve, reject) => canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("the browser made no picture"))), "image/png"));
}

/** Returns the format in which this browser records a canvas; undefined if it cannot record a canvas. */
export function videoFormat(): string | undefined {
  if (typeof MediaRecorder === "undefined" || !("captureStream" in HTMLCanvasElement.prototype)) return undefined;
  return FORMATS.find((format) => MediaRecorder.isTypeSupported(format));
}

export interface Recording {
  /** Adds the canvas's current content to the video. */
  frame(canvas: HTMLCanvasElement): void;
  stop(): Promise<{ blob: Blob; extension: string }>;
}

/** Records a video of a separate canvas, since the visible canvas may change its size meanwhile. */
export function record(width: number, height: number, format: string): Recording {
  const copy = document.createElement("canvas");
  const scale = Math.ceil(VIDEO_PX / width);
  // Encoders require even sizes.
  copy.width = width * scale - ((width * scale) % 2);
  copy.height = height * scale - ((height * scale) % 2);
  const context = copy.getContext("2d")!;
  const stream = copy.captureStream(30);
  const recorder = new MediaRecorder(stream, { mimeType: format, videoBitsPerSecond: BITS_PER_S });
  const chunks: Blob[] = [];
  recorder.ondataavailable = (event) => chunks.push(event.data);
  recorder.start();
  return {
    frame: (canvas) => context.drawImage(canvas, 0, 0, copy.width, copy.height),
    stop: () =>
      new Promise((resolve) => {
        recorder.onstop = () => resolve({ blob: new Blob(chunks, { type: format }), extension: format.includes("mp4") ? "mp4" : "webm" });
        recorder.stop();
        for (const track of stream.getTracks()) track.stop();
      }),
  };
}

/** Returns the file name for a title: "Still life" → "still-life". */
export function fileName(title: string): string {
  return (
    title
      .toLowerCase()
      .replace(/[^\p{L}\p{N}]+/gu, "-")
      .replace(/^-|-$/g, "") || "lumistack"
  );
}
