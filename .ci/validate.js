// Runs the Khronos validator over the files given; fails if it finds an error in any of them.
const fs = require("fs");
const validator = require("gltf-validator");

async function main(files) {
  let failed = 0;
  for (const file of files) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), { maxIssues: 20 });
    const errors = report.issues.messages.filter((message) => message.severity === 0);
    for (const error of errors) console.log(`${file}: ${error.code} ${error.pointer}: ${error.message}`);
    failed += report.issues.numErrors > 0;
  }
  console.log(`${files.length} files, ${failed} with errors`);
  process.exitCode = failed > 0 ? 1 : 0;
}

main(process.argv.slice(2));
