import { type Comparison, type Mode, type Path, type Slope } from "./state.js";
export interface LumistackErrorDetail {
    message: string;
    /** A possible remedy, as a sentence; empty if there is none. */
    advice: string;
    /** True if nothing can be shown. */
    fatal: boolean;
}
export declare class LumistackViewer extends HTMLElement {
    static readonly observedAttributes: string[];
    private readonly root;
    private readonly face;
    private readonly stageBox;
    private readonly picture;
    private readonly stage;
    private readonly motion;
    private readonly ticker;
    private readonly map;
    private readonly sliders;
    private readonly sheet;
    private readonly controls;
    private readonly address;
    private readonly loader;
    private state;
    private content;
    /** Small views that the viewer shows until the patterns have arrived. */
    private around;
    private resting;
    private frameClockS;
    private wordsTimer;
    private psnrTimer;
    private psnrKey;
    private life;
    constructor();
    /** Resolves when the first picture is shown; rejects if no picture can be shown. */
    get ready(): Promise<void>;
    /** Resolves when every file has arrived or failed; rejects if no frame is complete. */
    get complete(): Promise<void>;
    get src(): string;
    set src(value: string);
    get mode(): Mode;
    set mode(mode: Mode);
    /** The kind of comparison in the mode "compare". */
    get comparison(): Comparison;
    set comparison(comparison: Comparison);
    /** The slope of the view. Setting it ends the swing and the inertia of the view. */
    get slope(): Slope;
    set slope(slope: Slope);
    /** The renderer: "webgl2" or "cpu". */
    get path(): Path;
    /**
     * Returns the RGBA bytes of the current picture. Views and comparisons have the light field's
     * size. In the side-by-side comparison these are the bytes of the display's picture alone,
     * without the target. Before the first picture, the result is one transparent pixel.
     */
    pixels(): Promise<ImageData>;
    /** Returns the current picture as PNG. */
    screenshot(): Promise<Blob>;
    /** Saves a quilt of 8 × 6 views for lenticular displays: a PNG, `TITLE_qs8x6aASPECT.png`. */
    saveQuilt(): Promise<void>;
    /** Records one turn around the viewing zone and saves it as a video. */
    saveTurn(): Promise<void>;
    /** Shows files, given by path: a preview, a quilt, or the views of a light field. */
    open(files: ReadonlyMap<string, File>): Promise<void>;
    /**
     * Shows patterns that are being computed. `json` is the text of their preview.json. `codes`
     * contains the pictures of all files that `json` lists, in this order, [row][col][rgb] each. If
     * `json` is the current preview, only the patterns are replaced, all in one step.
     */
    showStack(json: string, codes: Uint8Array<ArrayBuffer>): Promise<void>;
    /**
     * Replaces all patterns of the current preview in one step. `files` contains a PNG for every file
     * of the preview, in the preview's order.
     */
    renew(files: readonly ArrayBuffer[]): Promise<void>;
    connectedCallback(): void;
    disconnectedCallback(): void;
    attributeChangedCallback(name: string, before: string | null, now: string | null): void;
    /** The hint on how to look around. With the attribute `plain` there is no button for tilt. */
    private get hint();
    private get module();
    private load;
    private dropContent;
    private show;
    /** Called when the simulator of the new content has started. */
    private opened;
    /** The poster that the page puts into the element, or else the image element for the preview's poster. */
    private get poster();
    private showPoster;
    private watchPoster;
    private get hasPoster();
    private lookInto;
    /** Limits the state to the display's layers and frames. */
    private fit;
    private arrived;
    private finish;
    private progress;
    private report;
    private pathChanged;
    private seen;
    private get keepsAddress();
    private wish;
    private readAddress;
    private set;
    /** Updates all parts for the state and requests a picture. */
    private stateChanged;
    private writeAddress;
    private layOut;
    /** Returns the picture to show; undefined while no frame is complete. */
    private shot;
    /**
     * Returns an object that computes seen pictures for other displays (headset, lenticular panel);
     * undefined while no frame is complete.
     */
    private views;
    /**
     * True while the poster or small views replace the picture. The mean of only a few frames is
     * noisy, so the picture appears when all frames are complete.
     */
    private get isEarly();
    private draw;
    /** Called when a picture is on the canvas. */
    private drawn;
    private drawingFailed;
    private describe;
    private playFrames;
    private stepFrame;
    private look;
}
