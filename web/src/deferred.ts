// A promise that is settled from outside.

export interface Deferred {
  promise: Promise<void>;
  resolve: () => void;
  reject: (error: Error) => void;
}

export function deferred(): Deferred {
  let resolve!: () => void;
  let reject!: (error: Error) => void;
  const promise = new Promise<void>((yes, no) => ([resolve, reject] = [yes, no]));
  // Whoever does not ask is told by the page itself.
  promise.catch(() => undefined);
  return { promise, resolve, reject };
}
