// Errors for the user, which consist of a message and a possible remedy.

export class Problem extends Error {
  constructor(
    message: string,
    readonly advice: string,
    /** True if the viewer cannot show any picture because of this problem. */
    readonly fatal = true,
  ) {
    super(message);
    this.name = "Problem";
  }
}

/** Converts any error to a Problem; `advice` is the remedy for an error that states no remedy. */
export function problemOf(error: unknown, advice: string): Problem {
  // Scripts that are loaded later contain another copy of this class, so `instanceof` would fail.
  if (error instanceof Error && error.name === "Problem") return error as Problem;
  return new Problem(error instanceof Error ? error.message : String(error), advice);
}

export const REWRITE = "Write the preview again with “lumistack preview” on the run folder, and load this page again.";
