import { type Comparison, type Mode, type Path, type Slope } from "./state.js";
export interface LumistackErrorDetail {
    message: string;
    /** What one can do about it. */
    advice: string;
    /** Nothing can be shown. */
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
    /** What one may look around in before the patterns are there. */
    private around;
    private resting;
    private frameClockS;
    private wordsTimer;
    private psnrTimer;
    private psnrKey;
    private life;
    constructor();
    /** Resolves with the first picture, rejects when there will be none. */
    get ready(): Promise<void>;
    /** Resolves when every file has arrived or failed and there is a picture. */
    get complete(): Promise<void>;
    get src(): string;
    set src(value: string);
    get mode(): Mode;
    set mode(mode: Mode);
    /** How the mode "compare" compares. */
    get comparison(): Comparison;
    set comparison(comparison: Comparison);
    /** Where one looks from. Setting it ends swing and inertia. */
    get slope(): Slope;
    set slope(slope: Slope);
    /** Who draws: "webgl2" or "cpu". */
    get path(): Path;
    /** RGBA bytes of the picture on show, at the light field's own size; of a comparison side by side those of the display. */
    pixels(): Promise<ImageData>;
    /** The picture on show as PNG. */
    screenshot(): Promise<Blob>;
    /** Shows what is among the files (path → file): a preview, a quilt, the views of a light field. */
    open(files: ReadonlyMap<string, File>): Promise<void>;
    /**
     * Shows patterns that are being computed: `json` is their preview, `codes` holds all its pictures in the preview's order, [row][col][rgb] each. Those of the
     * preview on show take the place of the former at once.
     */
    showStack(json: string, codes: Uint8Array<ArrayBuffer>): Promise<void>;
    /** Other patterns for the preview on show, a PNG for every file that it names: all of them take effect at once. */
    renew(files: readonly ArrayBuffer[]): Promise<void>;
    connectedCallback(): void;
    disconnectedCallback(): void;
    attributeChangedCallback(name: string, before: string | null, now: string | null): void;
    private get module();
    private load;
    private dropContent;
    private show;
    /** The simulator of what is on show has started. */
    private opened;
    /** The picture that a page brings along, or else the one that the preview names. */
    private get poster();
    private showPoster;
    private watchPoster;
    private get hasPoster();
    private lookInto;
    /** Keeps the state within what a display has. */
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
    /** Brings everything into line with the state and asks for a picture. */
    private stateChanged;
    private writeAddress;
    private layOut;
    /** What is to be seen now, where there are patterns. */
    private shot;
    /** Whether something stands in for the picture until every frame is there: the mean of a few is confetti. */
    private get isEarly();
    private draw;
    /** A picture is on the canvas. */
    private drawn;
    private drawingFailed;
    private describe;
    private playFrames;
    private stepFrame;
    private look;
}
