// SPDX-License-Identifier: MIT OR Apache-2.0
// Job type for Flamenco 3: a graph of units of work. Copy this file into the folder `scripts`
// beside the manager.

const JOB_TYPE = {
  label: "Lumistack",
  description: "Light fields and patterns of a tensor display, unit by unit",
  settings: [
    { key: "folder", type: "string", required: true, description: "Run folder that all workers share" },
    { key: "units", type: "string", required: true, visible: "hidden", description: "Units of work, JSON" },
  ],
};

function compileJob(job) {
  const tasks = {};
  for (const unit of JSON.parse(job.settings.units)) {
    const task = author.Task(unit.id, unit.kind === "views" || unit.kind === "score" ? "blender" : "misc");
    task.addCommand(author.Command("exec", { exe: unit.command[0], args: unit.command.slice(1) }));
    for (const input of unit.inputs) {
      task.addDependency(tasks[input]);
    }
    tasks[unit.id] = task;
    job.addTask(task);
  }
}
