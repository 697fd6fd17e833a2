import { type Comparison, type Mode, type Path, type Slope } from "./state.js";
export interface LumistackErrorDetail {
    message: string;
    /** A possible remedy. */
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
    /** Views to look around in before the patterns have arrived. */
    private around;
    private resting;
    private frameClockS;
    private wordsTimer;
    private psnrTimer;
    private psnrKey;
    private life;
    constructor();
    /** Resolves with the first picture; rejects if there will be none. */
    get ready(): Promise<void>;
    /** Resolves when every file has arrived or failed and there is a picture. */
    get complete(): Promise<void>;
    get src(): string;
    set src(value: string);
    get mode(): Mode;
    set mode(mode: Mode);
    /** The kind of comparison in the mode "compare". */
    get comparison(): Comparison;
    set comparison(comparison: Comparison);
    /** The slope of the view. Setting it ends swing and inertia. */
    get slope(): Slope;
    set slope(slope: Slope);
    /** The renderer: "webgl2" or "cpu". */
    get path(): Path;
    /**
     * RGBA bytes of the current picture, in the light field's size; of a side-by-side comparison
     * those of the display.
     */
    pixels(): Promise<ImageData>;
    /** The current picture as PNG. */
    screenshot(): Promise<Blob>;
    /** Saves a quilt of 8 × 6 views for lenticular displays: a PNG whose name ends in `_qs8x6aASPECT`. */
    saveQuilt(): Promise<void>;
    /** Records one turn around the zone and saves it as a video. */
    saveTurn(): Promise<void>;
    /** Shows the files (path → file): a preview, a quilt, or the views of a light field. */
    open(files: ReadonlyMap<string, File>): Promise<void>;
    /**
     * Shows patterns that are being computed. `json` is their preview, and `codes` contains all its
     * pictures in the preview's order, [row][col][rgb] each. Patterns of the current preview are
     * replaced at once.
     */
    showStack(json: string, codes: Uint8Array<ArrayBuffer>): Promise<void>;
    /**
     * Replaces the patterns of the current preview at once; `files` has a PNG for every file that it
     * names.
     */
    renew(files: readonly ArrayBuffer[]): Promise<void>;
    connectedCallback(): void;
    disconnectedCallback(): void;
    attributeChangedCallback(name: string, before: string | null, now: string | null): void;
    private get module();
    private load;
    private dropContent;
    private show;
    /** Called when the simulator of the current content has started. */
    private opened;
    /** The poster in the page, otherwise the one that the preview names. */
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
    /** The picture to show; undefined without patterns. */
    private shot;
    /** The seen pictures for other displays; undefined without patterns. */
    private views;
    /** True while a substitute is shown: the mean of a few frames is only noise. */
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
