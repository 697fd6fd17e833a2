// Something went wrong: what, and what the reader can do about it.

export class Problem extends Error {
  constructor(
    message: string,
    readonly advice: string,
    /** Nothing can be shown. */
    readonly fatal = true,
  ) {
    super(message);
    this.name = "Problem";
  }
}

/** An error of any origin as one with advice. */
export function problemOf(error: unknown, advice: string): Problem {
  if (error instanceof Problem) return error;
  return new Problem(error instanceof Error ? error.message : String(error), advice);
}

export const REWRITE = "Write the preview again with “lumistack preview” on the run folder, and load this page again.";
