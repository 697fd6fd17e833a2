// The HTML inside the element. Icons have 20 × 20 units.

const icon = (path: string): string =>
  `<svg viewBox="0 0 20 20" aria-hidden="true" fill="none" stroke="currentColor" stroke-width="1.5" stroke-linecap="round" stroke-linejoin="round">${path}</svg>`;

export const ICONS = {
  open: icon('<path d="M3 6.5V15a1 1 0 0 0 1 1h12a1 1 0 0 0 1-1V7.5a1 1 0 0 0-1-1h-6L8.5 4.5H4a1 1 0 0 0-1 1z"/>'),
  link: icon('<path d="M8.5 11.5a3 3 0 0 0 4.3 0l2.4-2.4a3 3 0 0 0-4.3-4.3l-1 1M11.5 8.5a3 3 0 0 0-4.3 0l-2.4 2.4a3 3 0 0 0 4.3 4.3l1-1"/>'),
  camera: icon('<path d="M3 7.5a1 1 0 0 1 1-1h2.4L7.7 4.5h4.6l1.3 2H16a1 1 0 0 1 1 1V15a1 1 0 0 1-1 1H4a1 1 0 0 1-1-1z"/><circle cx="10" cy="11" r="2.7"/>'),
  record: icon('<circle cx="10" cy="10" r="6.5"/><circle cx="10" cy="10" r="2.6" fill="currentColor" stroke="none"/>'),
  elsewhere: icon('<path d="M2.5 7.5a1 1 0 0 1 1-1h13a1 1 0 0 1 1 1V13a1 1 0 0 1-1 1h-3.2l-1.6-2a2.2 2.2 0 0 0-3.4 0l-1.6 2H3.5a1 1 0 0 1-1-1z"/>'),
  theme: icon('<circle cx="10" cy="10" r="6.5"/><path d="M10 3.5a6.5 6.5 0 0 1 0 13z" fill="currentColor" stroke="none"/>'),
  full: icon('<path d="M4 8V4h4M12 4h4v4M16 12v4h-4M8 16H4v-4"/>'),
  play: icon('<path d="M6.5 4.5v11l9-5.5z" fill="currentColor"/>'),
  pause: icon('<path d="M7 5v10M13 5v10" stroke-width="2.4"/>'),
  back: icon('<path d="M12 5l-5 5 5 5"/>'),
  on: icon('<path d="M8 5l5 5-5 5"/>'),
  close: icon('<path d="M5.5 5.5l9 9M14.5 5.5l-9 9"/>'),
};

const tab = (mode: string, label: string, key: number): string =>
  `<label title="${label.replace(/<.*?>/g, "")} (${key})"><input type="radio" name="mode" value="${mode}"><span>${label}</span></label>`;

const button = (name: keyof typeof ICONS, id: string, label: string): string =>
  `<button type="button" class="tool" id="${id}" aria-label="${label}" title="${label}">${ICONS[name]}</button>`;

const range = (id: string, label: string, hint: string): string =>
  `<div class="control" id="${id}-row"><label for="${id}">${label}</label><output for="${id}" id="${id}-value"></output>
   <input type="range" id="${id}" aria-describedby="${id}-hint"><p class="hint" id="${id}-hint">${hint}</p></div>`;

export const TEMPLATE = `
<div class="frame" data-mode="perceived">
  <header class="bar">
    <div class="heading"><h1 id="title">Lumistack</h1><p id="facts"></p></div>
    <div class="modes" role="radiogroup" aria-label="What is shown">
      ${tab("perceived", "Perceived", 1)}${tab("slow", "Slow<i> motion</i>", 2)}${tab("exploded", "Exploded", 3)}${tab("compare", "Compare", 4)}${tab("layers", "Layers", 5)}
    </div>
    <div class="tools">
      ${button("open", "open", "Open a preview, a quilt or a light field")}${button("link", "link", "Copy a link to this view")}${button("camera", "shot", "Save a picture")}
      ${button("record", "record", "Record a turn as video")}${button("elsewhere", "elsewhere", "Show it on another display")}${button("theme", "theme", "Switch between dark and light")}${button("full", "full", "Fill the screen")}
    </div>
  </header>
  <div class="stage" id="stage" tabindex="0" role="group" aria-roledescription="light field display" aria-label="Picture" aria-describedby="keys">
    <div class="picture" id="picture">
      <div class="shown" id="shown" role="img" aria-label="Picture"><slot name="poster"><img id="poster" alt="" hidden></slot><canvas id="early" aria-hidden="true"></canvas></div>
      <button type="button" class="divider" id="divider" role="slider" aria-label="Boundary between display and target" aria-valuemin="0" aria-valuemax="100" aria-valuenow="50" hidden><span></span></button>
      <span class="tag left" id="tag-left" hidden>Display</span><span class="tag right" id="tag-right" hidden>Target</span>
      <p class="nudge" id="nudge" hidden></p>
    </div>
    <div class="progress" id="progress" role="progressbar" aria-label="Loading" aria-valuemin="0" aria-valuemax="100" hidden><i></i><span></span></div>
    <div class="notice" id="notice" role="status" hidden><span></span><button type="button" aria-label="Dismiss">${ICONS.close}</button></div>
    <div class="card" id="card" role="alert" hidden><h2>Nothing to show</h2><p class="what"></p><p class="advice"></p><button type="button" class="wide" id="card-open">Open files…</button></div>
    <div class="drop" id="drop" hidden><p>Drop a preview folder, a quilt<br>or a folder of views</p></div>
    <p class="hidden" id="keys">Arrow keys look around, Shift makes larger steps, Home looks straight ahead, 1 to 5 choose what is shown, Space pauses.</p>
  </div>
  <div class="dock" id="dock">
    <div class="group" data-for="slow">
      <button type="button" class="tool" id="step-back" aria-label="Previous frame" title="Previous frame (,)">${ICONS.back}</button>
      <button type="button" class="tool" id="play" aria-label="Pause">${ICONS.pause}</button>
      <button type="button" class="tool" id="step-on" aria-label="Next frame" title="Next frame (.)">${ICONS.on}</button>
      <output class="count" id="frame-count"></output>
      <label class="inline">Speed <input type="range" id="rate" min="-2" max="6" step="0.25" aria-label="Frames per second"><output id="rate-value" for="rate"></output></label>
    </div>
    <div class="group" data-for="exploded">
      <label class="inline">Spread <input type="range" id="spread" min="0" max="1" step="0.01"></label>
      <label class="inline" id="exploded-frame-label">Frame <input type="range" id="exploded-frame" min="0" max="0" step="1"><output id="exploded-frame-value"></output></label>
      <button type="button" class="text" id="front">Front view</button>
    </div>
    <div class="group" data-for="compare">
      <div class="modes small" role="radiogroup" aria-label="How to compare">
        <label><input type="radio" name="comparison" value="slider"><span>Slider</span></label><label><input type="radio" name="comparison" value="side"><span>Side by side</span></label><label><input type="radio" name="comparison" value="error"><span>Error</span></label>
      </div>
      <div class="legend" id="legend" hidden><span>0</span><i></i><span id="legend-most"></span></div>
      <output class="count" id="psnr" aria-live="polite"></output>
    </div>
    <div class="group sheet" data-for="layers" id="sheet"></div>
  </div>
  <section class="panel" aria-label="Controls">
    <div class="part">
      <p class="caption" id="caption"></p>
      <button type="button" class="primary" id="apart">Take it apart</button>
      <h2>Where you look from</h2>
      <div class="pad" id="pad" tabindex="0" role="application" aria-label="Viewing position; arrow keys move the position" aria-describedby="place"></div>
      <p class="place" id="place"></p>
      <p class="hidden" id="live" aria-live="polite"></p>
      <div class="row">
        <button type="button" class="text" id="centre">Straight ahead</button>
        <button type="button" class="text toggle" id="swing" aria-pressed="true">Swing when idle</button>
        <button type="button" class="text toggle" id="tilt" aria-pressed="false" hidden>Tilt</button>
      </div>
    </div>
    <details class="part" id="build">
      <summary>How it is built</summary>
      ${range("gain", "Adaptation", "Factor on the light. For an eye that is adapted to the brightness β, the factor is 1/β.")}
      ${range("gap", "Gap error", "Added to every gap between layers, and to the gap to a directional backlight.")}
      ${range("shiftx", "Misalignment across", "Offset of the front layer to the right.")}
      ${range("shifty", "Misalignment upwards", "Offset of the front layer upwards.")}
      ${range("black", "Black level", "Fraction of the light that a closed pixel transmits.")}
      ${range("pupil", "Pupil", "Diameter of the viewer's pupil; a wide pupil mixes views.")}
      ${range("eye", "Eye distance", "A near eye sees several views at once.")}
      <div class="row"><button type="button" class="text" id="reset">As designed</button></div>
    </details>
    <footer id="footer"></footer>
  </section>
  <dialog id="chooser" aria-label="Open">
    <h2>Open</h2>
    <p>Nothing leaves this computer.</p>
    <button type="button" class="wide" id="choose-folder">A folder: preview, run or views</button>
    <button type="button" class="wide" id="choose-files">Files: a quilt (name_qs8x6a0.75.png) or views</button>
    <form method="dialog"><button class="text">Cancel</button></form>
  </dialog>
  <dialog id="others" aria-labelledby="others-title">
    <h2 id="others-title">Show it on another display</h2>
    <button type="button" class="wide" id="headset" disabled>Headset<small>The display stands before you in its true size. This needs a headset that the browser supports.</small></button>
    <button type="button" class="wide" id="lenticular">Lenticular panel<small>Weaves the picture for one panel. Choose its calibration file, visual.json.</small></button>
    <div class="row" id="woven-row" hidden><button type="button" class="text" id="fill">Fill the screen</button><button type="button" class="text" id="woven">Save the woven picture</button></div>
    <button type="button" class="wide" id="bridge">Looking Glass Bridge<small>Saves a quilt, and shows it on the panel that Bridge drives on this computer.</small></button>
    <label class="field">For Bridge: the folder where this browser saves files <input id="stored" autocomplete="off" spellcheck="false"></label>
    <p id="others-status" role="status"></p>
    <form method="dialog"><button class="text">Close</button></form>
  </dialog>
  <input type="file" id="calibration" accept=".json,application/json" hidden><input type="file" id="files" multiple accept="image/*,.json" hidden><input type="file" id="folder" webkitdirectory hidden>
</div>`;
