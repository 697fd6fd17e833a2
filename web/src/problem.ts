// An error for the user: the message, and a possible remedy.

export class Problem extends Error {
  constructor(
    message: string,
    readonly advice: string,
    /** True if nothing can be shown. */
    readonly fatal = true,
  ) {
    super(message);
    this.name = "Problem";
  }
}

/** Converts any error to one with advice. */
export function problemOf(error: unknown, advice: string): Problem {
  // Scripts that are loaded later have a class of their own.
  if (error instanceof Error && error.name === "Problem") return error as Problem;
  return new Problem(error instanceof Error ? error.message : String(error), advice);
}

export const REWRITE = "Write the preview again with “lumistack preview” on the run folder, and load this page again.";
