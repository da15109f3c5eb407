// Runs the Khronos validator over files given as OUTPUT or OUTPUT=INPUT. Fails if an output has an error; with an input,
// if it has one of a kind that the input does not have.
const fs = require("fs");
const validator = require("gltf-validator");

async function errorsOf(file) {
  const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), { maxIssues: 1000 });
  return report.issues.messages.filter((message) => message.severity === 0);
}

async function main(pairs) {
  let failed = 0;
  for (const pair of pairs) {
    const [output, input] = pair.split("=");
    const known = new Set(input ? (await errorsOf(input)).map((error) => error.code) : []);
    const errors = (await errorsOf(output)).filter((error) => !known.has(error.code));
    for (const error of errors.slice(0, 5)) console.log(`${output}: ${error.code} ${error.pointer}: ${error.message}`);
    failed += errors.length > 0;
  }
  console.log(`${pairs.length} files, ${failed} with errors that their input does not have`);
  process.exitCode = failed > 0 ? 1 : 0;
}

main(process.argv.slice(2));
