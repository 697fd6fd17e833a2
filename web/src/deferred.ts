// A promise that other code resolves or rejects.

export interface Deferred {
  promise: Promise<void>;
  resolve: () => void;
  reject: (error: Error) => void;
  settled: boolean;
}

export function deferred(): Deferred {
  let resolve!: () => void;
  let reject!: (error: Error) => void;
  const promise = new Promise<void>((yes, no) => ([resolve, reject] = [yes, no]));
  // The browser's console reports a rejected promise that has no handler. The page shows the error
  // itself, so an empty handler prevents this second report.
  promise.catch(() => undefined);
  const made: Deferred = {
    promise,
    settled: false,
    resolve: () => {
      made.settled = true;
      resolve();
    },
    reject: (error) => {
      made.settled = true;
      reject(error);
    },
  };
  return made;
}
